// Browsers let no page that was opened from a file start a worker, in which the search runs.  There a hidden frame takes
// the worker's place.  The name of this file tells the theme's plugin "offline" that it needs none from elsewhere.
"use strict";
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.append(this.frame);
      const inside = this.frame.contentDocument;
      window.addEventListener("message", (event) => {
        if (event.source !== this.frame.contentWindow) return;
        const told = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(told);
        if (this.onmessage) this.onmessage(told);
      });
      const begin =
        'postMessage = (data) => parent.postMessage(data, "*");' +
        "importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done, failed) => {" +
        "  const script = document.createElement('script'); script.src = url; script.onload = done; script.onerror = failed;" +
        "  document.body.append(script); })), Promise.resolve());";
      this.ready = new Promise((done) => {
        inside.open();
        inside.write("<!doctype html><html><body></body></html>");
        inside.close();
        for (const part of [{ text: begin }, { src: new URL(url, location.href).href }]) {
          const script = inside.createElement("script");
          Object.assign(script, part);
          script.onload = done;
          inside.body.append(script);
        }
      });
    }

    postMessage(data) {
      this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })));
    }

    terminate() {
      this.frame.remove();
    }
  };
}
