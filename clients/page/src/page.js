"use strict";
// Carries messages between this page and a worker, and bytes between the worker and a board on a serial port.
{
  const CANNOT = "This browser cannot open a board: Chrome or Edge on a desktop can. The simulation continues.";
  const REAL = "A board with real motors: Space turns them on. Keep an emergency stop in their supply.";
  // USB numbers of the boards (host/src/link/ports.rs).
  const BOARDS = { filters: [{ usbVendorId: 0x1209, usbProductId: 0x0001 }] };
  const library = Uint8Array.from(atob($text("library")), c => c.charCodeAt(0));
  const worker = URL.createObjectURL(new Blob([$text("worker")], { type: "text/javascript" }));
  function $text(id) { const element = document.getElementById(id), text = element.textContent; element.remove(); return text; }
  const device = document.createElement("select"), lesson = document.createElement("select"), open = document.createElement("button");
  // The list of devices already shows the device's name.
  document.getElementById("device").hidden = true;
  device.id = "choice"; lesson.id = "lesson"; open.id = "open"; open.textContent = "Open a board";
  device.setAttribute("aria-label", "Device"); lesson.setAttribute("aria-label", "Set-up of a lesson");
  document.querySelector("header .grow").before(device, lesson, open);
  // `port` is the port of the open board, `leave` closes the present device, and `news` is the notice to show after the
  // first picture.
  let port = null, leave = () => {}, news = null;
  window.playground = () => {
    const choice = Math.max(0, device.selectedIndex), board = port !== null, thread = new Worker(worker);
    const cable = board ? connected(port, thread) : null;
    const carrier = { readyState: 0, send: said => thread.postMessage({ said, at: performance.now() }) };
    const close = () => { cable?.pull(); thread.terminate(); };
    leave = () => { carrier.readyState = 3; if (board) thread.postMessage({ over: true }); else close(); };
    const end = why => {
      const before = carrier.readyState;
      if (before === 1) up();
      carrier.readyState = 3;
      if (!board) { close(); console.error(why); carrier.onclose(); }
      // A lost board stays on the page until the user chooses a simulation.
      else if (before === 1) {
        port = null;
        open.textContent = "Open a board";
        lost(view.last ? `${why}; ${view.last.if_lost}` : why);
      }
      else if (before === 0) { news = [`${why}. The simulation continues.`]; begin(null); }
    };
    thread.onmessage = ({ data }) => {
      if (data.sent) cable.send(data.sent);
      else if (data.ended) close();
      else if (carrier.readyState === 3) return;
      else if (data.stopped) end(data.stopped);
      else if (data.choices) {
        if (!device.length) {
          device.replaceChildren(...data.choices.map(name => new Option(name)));
          lesson.replaceChildren(new Option("Lessons"), ...LESSONS.map(([name]) => new Option(name)));
          lessonShown();
        }
        device.selectedIndex = board ? -1 : choice;
        if (!board && wanted() >= 0 && wanted() !== choice) { device.selectedIndex = wanted(); return begin(null); }
        open.textContent = board ? "Close the board" : "Open a board";
        if (board) news = [REAL, {}, true];
        carrier.readyState = 1;
        carrier.onopen();
      } else {
        carrier.onmessage({ data });
        if (news && view.last) { notice(...news); news = null; }
      }
    };
    thread.onerror = event => { end(event.message); close(); };
    thread.postMessage({ library, choice, board });
    return carrier;
  };
  // Returns the index of the device in the page's link, or of its first scene; -1 for no device or an unknown device.
  function wanted() {
    const name = view.wanted?.device;
    if (!name) return -1;
    const found = [...device.options].findIndex(({ value }) => [":", "/"].some(end => value.startsWith(name + end)));
    if (found < 0) { const why = [`This page does not have the link's device ${name}: nothing was changed.`, { of: "link" }]; view.wanted = null; if (view.last) notice(...why); else news = why; }
    return found;
  }
  const lessonShown = () => { lesson.selectedIndex = +(/lesson=(\d)/.exec(location.hash)?.[1] || 0); };
  window.playground.follow = () => { lessonShown(); if (!port && wanted() >= 0 && wanted() !== device.selectedIndex) { device.selectedIndex = wanted(); begin(null); } };
  // Carries bytes between an open port and a worker. A port has a new stream after a temporary error, and no stream
  // after it was unplugged.
  function connected(port, thread) {
    const writer = port.writable.getWriter();
    let reader = null, stream = null, pulled = false;
    (async () => {
      let why = "its port has closed";
      while (!pulled && port.readable && port.readable !== stream) {
        stream = port.readable; reader = stream.getReader();
        try { for (let read; !(read = await reader.read()).done;) thread.postMessage({ came: read.value }); }
        catch (error) { why = error.message; }
        reader.releaseLock();
      }
      thread.postMessage({ gone: why });
    })();
    return {
      send: bytes => writer.write(bytes).catch(error => thread.postMessage({ gone: error.message })),
      pull: async () => {
        pulled = true;
        const steps = [() => reader.cancel(), () => writer.abort(), () => writer.releaseLock(), () => port.close()];
        for (const step of steps) try { await step(); } catch { /* The port was unplugged. */ }
      },
    };
  }
  // Starts with another device or board.
  function begin(board) {
    up();
    leave();
    port = board;
    view.hello = view.plane = view.closeAt = view.last = view.frame = null;
    connect();
  }
  device.onchange = () => { device.blur(); lesson.selectedIndex = 0; begin(null); };
  lesson.onchange = () => { if (lesson.selectedIndex) location.hash = "lesson=" + lesson.selectedIndex; lesson.blur(); };
  open.onclick = async () => {
    open.blur();
    if (port) return begin(null);
    if (!navigator.serial || !WebAssembly.Suspending) return notice(CANNOT);
    let chosen;
    // Fails if the user closes the browser's list without a choice.
    try { chosen = await navigator.serial.requestPort(BOARDS); } catch { return; }
    try {
      await chosen.open({ baudRate: 115200, bufferSize: 1 << 18 });
      await chosen.setSignals({ dataTerminalReady: true });
    } catch (error) {
      // Closes the port, because an open port is locked for other programs.
      await chosen.close().catch(() => {});
      const why = `The port cannot be opened (${error.message}): close the program that uses it.`;
      return notice(`${why} The simulation continues.`);
    }
    begin(chosen);
  };
}
