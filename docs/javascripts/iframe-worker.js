// Browsers start no worker for a page that is opened from a folder. The search of these pages then runs in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(script) {
      super()
      this.waiting = []
      const frame = document.createElement("iframe")
      frame.hidden = true
      frame.srcdoc = "<!doctype html><body></body>"
      frame.addEventListener("load", () => this.start(frame.contentWindow, new URL(script, document.baseURI).href), { once: true })
      const add = () => document.body.append(frame)
      document.body ? add() : addEventListener("DOMContentLoaded", add)
    }

    start(inner, script) {
      inner.postMessage = data => this.dispatchEvent(new MessageEvent("message", { data }))
      const element = inner.document.createElement("script")
      element.src = script
      element.onload = () => {
        this.inner = inner
        this.waiting.forEach(data => this.postMessage(data))
      }
      inner.document.body.append(element)
    }

    postMessage(data) {
      this.inner ? this.inner.dispatchEvent(new MessageEvent("message", { data })) : this.waiting.push(data)
    }

    terminate() {}
  }
}
