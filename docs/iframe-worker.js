// Search without a server: browsers start no Worker from a file, so its script runs in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.inside = frame.contentWindow
      window.addEventListener("message", event => {
        if (event.source === this.inside) this.dispatchEvent(new MessageEvent("message", { data: event.data }))
      })
      const forWorkers = `
        postMessage = data => parent.postMessage(data, "*")
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise(resolve => {
          const script = document.createElement("script")
          Object.assign(script, { src: url, onload: resolve })
          document.body.append(script)
        })), Promise.resolve())`
      this.inside.document.open()
      this.inside.document.write(`<body><script>${forWorkers}<\/script><script src="${url}"><\/script></body>`)
      this.inside.document.close()
      this.loaded = new Promise(resolve => { this.inside.addEventListener("load", resolve) })
    }

    postMessage(data) {
      this.loaded.then(() => { this.inside.dispatchEvent(new MessageEvent("message", { data })) })
    }
  }
}
