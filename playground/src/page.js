"use strict";
// What carries the messages of this page: a worker in the place of a WebSocket.
{
  const library = Uint8Array.from(atob($text("library")), c => c.charCodeAt(0));
  const worker = URL.createObjectURL(new Blob([$text("worker")], { type: "text/javascript" }));
  function $text(id) { const element = document.getElementById(id), text = element.textContent; element.remove(); return text; }
  const device = document.createElement("select");
  device.id = "choice";
  device.setAttribute("aria-label", "Device");
  document.querySelector("header .grow").before(device);
  let thread = null;
  window.playground = () => {
    const choice = Math.max(0, device.selectedIndex);
    const carrier = { readyState: 0, send: text => thread.postMessage(text) };
    const end = why => { thread.terminate(); carrier.readyState = 3; console.error(why); carrier.onclose(); };
    thread = new Worker(worker);
    thread.onmessage = ({ data }) => {
      if (data.choices) {
        if (!device.length) device.replaceChildren(...data.choices.map(name => new Option(name)));
        carrier.readyState = 1;
        carrier.onopen();
      } else if (data.stopped) end(data.stopped);
      else carrier.onmessage({ data });
    };
    thread.onerror = event => end(event.message);
    thread.postMessage({ library, choice });
    return carrier;
  };
  // Another device begins anew.
  device.onchange = () => {
    up();
    device.blur();
    thread.terminate();
    view.hello = view.plane = view.closeAt = null;
    connect();
  };
}
