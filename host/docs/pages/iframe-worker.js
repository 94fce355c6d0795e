// SPDX-License-Identifier: Apache-2.0
// Pages opened as files may not start workers. This stands in for the one of the search: its script runs in a hidden
// frame, which shares the page's origin, and messages go both ways as events.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    #frame = document.createElement("iframe");
    #ready;

    constructor(url) {
      super();
      this.#frame.hidden = true;
      this.#ready = new Promise((resolve, reject) => {
        this.#frame.addEventListener("load", () => {
          const inside = this.#frame.contentWindow;
          inside.postMessage = (data) => this.#answer(data);
          const script = inside.document.createElement("script");
          script.src = new URL(url, location.href).href;
          script.onload = () => resolve(inside);
          script.onerror = () => reject(new Error(`${script.src}: cannot be read`));
          inside.document.head.append(script);
        }, { once: true });
      });
      this.#frame.srcdoc = "<!doctype html><title>search</title>";
      document.documentElement.append(this.#frame);
    }

    #answer(data) {
      const event = new MessageEvent("message", { data });
      this.dispatchEvent(event);
      this.onmessage?.(event);
    }

    postMessage(data) {
      this.#ready.then((inside) => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }

    terminate() {
      this.#frame.remove();
    }
  };
}
