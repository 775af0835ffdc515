"use strict";
// The worker runs the library by the browser's clock and carries its messages to the page, and its bytes to the port of
// a board that the page has opened.
onmessage = async first => {
  const { library: code, board } = first.data;
  // Bytes from the port that were not fetched, the function that ends a wait for them, and the reason why the port is
  // gone.
  const came = [];
  let wake = () => {}, gone = null, over = false;
  let library;
  const bytes = () => new Uint8Array(library.memory.buffer, library.address(), library.length()).slice();
  const words = () => new TextDecoder().decode(bytes());
  const put = what => {
    const at = library.room(what.length);
    new Uint8Array(library.memory.buffer, at, what.length).set(what);
  };
  const putWords = text => put(new TextEncoder().encode(text));
  // Suspends the library until bytes arrive; the page's messages are still received meanwhile.
  const receive = async (most, milliseconds) => {
    if (!came.length && gone === null) {
      let timer;
      await new Promise(done => { timer = setTimeout(done, milliseconds); wake = done; });
      clearTimeout(timer);
    }
    if (!came.length && gone !== null) { putWords(gone); return 0; }
    const piece = came.shift() || new Uint8Array();
    if (piece.length > most) came.unshift(piece.subarray(most));
    put(piece.subarray(0, most));
    return 1;
  };
  const port = {
    now: () => performance.now(),
    draw: () => crypto.getRandomValues(new Uint32Array(1))[0],
    send: () => { const sent = bytes(); postMessage({ sent }, [sent.buffer]); },
    receive: board ? new WebAssembly.Suspending(receive) : () => 0,
  };
  const waiting = name => board ? WebAssembly.promising(library[name]) : library[name];
  // Set first, because a board may already be sending.
  onmessage = ({ data }) => {
    if (data.said) { putWords(data.said); library.said(data.at); }
    else if (data.came) { came.push(data.came); wake(); }
    else if ("gone" in data) { gone = data.gone; wake(); }
    else over = true;
  };
  try {
    library = (await WebAssembly.instantiate(code, { port })).instance.exports;
    if (!await (board ? waiting("open_board")() : library.open())) throw words();
    postMessage({ opened: true });
    const began = performance.now(), turn = waiting("turn");
    const play = async () => {
      try {
        // The limit is below the interval of pictures, so that the page's messages do not wait long.
        const until = performance.now() + 12;
        let turned;
        do turned = await turn(performance.now() - began); while (turned === 1 && performance.now() < until);
        if (turned === 2) throw words();
        for (let kind; (kind = library.next());) postMessage(kind === 1 ? words() : bytes().buffer);
        if (over) { await waiting("finish")(0); postMessage({ ended: true }); } else setTimeout(play, 2);
      } catch (error) { stopped(error); }
    };
    play();
  } catch (error) { stopped(error); }
  // The page gets the reason first, because a board that does not reply takes time.
  async function stopped(error) {
    postMessage({ stopped: String(error) });
    if (!board) return;
    try { await waiting("finish")(1); } catch { /* The board watches its host itself. */ }
    postMessage({ ended: true });
  }
};
