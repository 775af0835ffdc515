"use strict";
// The worker: lets the library play by the browser's clock, and carries what it says.
onmessage = async first => {
  try {
    const { exports: library } = (await WebAssembly.instantiate(first.data.library)).instance;
    const bytes = () => new Uint8Array(library.memory.buffer, library.address(), library.length()).slice();
    const words = () => new TextDecoder().decode(bytes());
    library.choices();
    const choices = words().split("\n");
    if (!library.open(first.data.choice)) throw words();
    onmessage = event => {
      const text = new TextEncoder().encode(event.data);
      new Uint8Array(library.memory.buffer, library.room(text.length), text.length).set(text);
      library.said();
    };
    postMessage({ choices });
    const began = performance.now();
    const play = () => {
      try {
        // Not longer than most of a picture, or what the page says would wait.
        const until = performance.now() + 12;
        let turn;
        do turn = library.turn(performance.now() - began); while (turn === 1 && performance.now() < until);
        if (turn === 2) throw words();
        for (let kind; (kind = library.next());) postMessage(kind === 1 ? words() : bytes().buffer);
        setTimeout(play, 2);
      } catch (error) { postMessage({ stopped: String(error) }); }
    };
    play();
  } catch (error) { postMessage({ stopped: String(error) }); }
};
