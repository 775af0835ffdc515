"use strict";
// Carries the messages of this page: to a worker instead of a WebSocket, and between the worker and a board over a
// serial port of this browser.
{
  const CANNOT = "This browser cannot open a board: Chrome or Edge on a desktop can. The simulation continues.";
  const REAL = "A board with real motors: Space turns them on. Keep an emergency stop in their supply.";
  // USB numbers of the boards (host/src/link/ports.rs).
  const BOARDS = { filters: [{ usbVendorId: 0x1209, usbProductId: 0x0001 }] };
  const library = Uint8Array.from(atob($text("library")), c => c.charCodeAt(0));
  const worker = URL.createObjectURL(new Blob([$text("worker")], { type: "text/javascript" }));
  function $text(id) { const element = document.getElementById(id), text = element.textContent; element.remove(); return text; }
  const open = document.createElement("button");
  open.id = "open"; open.className = "rare"; open.textContent = "Open a board";
  document.querySelector("header .grow").after(open);
  // The port of the open board, if there is one; the function that closes the present world; the notice to show after
  // the first picture.
  let port = null, leave = () => {}, news = null;
  window.playground = () => {
    const board = port !== null, thread = new Worker(worker);
    const cable = board ? connected(port, thread) : null;
    const carrier = { readyState: 0, send: said => thread.postMessage({ said, at: performance.now() }) };
    const close = () => { cable?.pull(); thread.terminate(); };
    leave = () => { carrier.readyState = 3; if (board) thread.postMessage({ over: true }); else close(); };
    const end = why => {
      const before = carrier.readyState;
      if (before === 1) up();
      carrier.readyState = 3;
      if (!board) { close(); console.error(why); carrier.onclose(); }
      // If a board was shown, a simulation replaces it only on request.
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
      else if (data.opened) {
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
    thread.postMessage({ library, board });
    return carrier;
  };
  // Carries bytes between an open port and a worker. After a temporary error a port has a new stream; an unplugged port
  // has none.
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
  // Starts with the simulation or a board.
  function begin(board) {
    up();
    leave();
    port = board;
    view.hello = view.plane = view.last = view.frame = null;
    connect();
  }
  open.onclick = async () => {
    open.blur();
    if (port) return begin(null);
    if (!navigator.serial || !WebAssembly.Suspending) return notice(CANNOT);
    let chosen;
    // The user closed the browser's list without a choice.
    try { chosen = await navigator.serial.requestPort(BOARDS); } catch { return; }
    try {
      await chosen.open({ baudRate: 115200, bufferSize: 1 << 18 });
      await chosen.setSignals({ dataTerminalReady: true });
    } catch (error) {
      // An open port that is not used would lock out other programs.
      await chosen.close().catch(() => {});
      const why = `The port cannot be opened (${error.message}): close the program that uses it.`;
      return notice(`${why} The simulation continues.`);
    }
    begin(chosen);
  };
}
