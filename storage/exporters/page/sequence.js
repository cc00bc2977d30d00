// What the document holds: the description, coded frames, and the worker that decodes and sorts them.

const textOf = (id) => document.getElementById(id).textContent;

class Sequence {
  constructor() {
    this.head = JSON.parse(textOf("head"));
    for (const view of this.head.views) view.centre = centreOf(view.pose);
    this.bytes = 0;
    const coded = this.head.frames.map((_, f) => this.taken(`frame-${f}`));
    this.there = coded.map(Boolean);
    this.pictures = this.head.frames.map((_, f) => this.taken(`pictures-${f}`).split(","));
    const code = new Blob([textOf("worker")], { type: "text/javascript" });
    this.worker = new Worker(URL.createObjectURL(code));
    this.worker.onmessage = ({ data }) => this.arrived(data);
    this.worker.postMessage({ head: this.head, coded });
    this.waiting = new Map();
    this.asked = 0;
  }

  // Text of an element, which is taken out of the document: memory holds it once. A page that is served holds no
  // frames; they come by `put`.
  taken(id) {
    const element = document.getElementById(id), text = element ? element.textContent : "";
    if (!element) return text;
    element.remove();
    this.bytes += text.length;
    return text;
  }

  // Takes a frame that has come, or has come anew.
  put(frame, coded, pictures) {
    this.there[frame] = true;
    this.pictures[frame] = pictures.split(",");
    this.bytes += coded.length + pictures.length;
    this.worker.postMessage({ put: frame, coded });
  }

  // The frame itself where it is there, else the last one before it, else the first of all; -1 before any is.
  nearest(frame) {
    const before = this.there.lastIndexOf(true, frame);
    return before < 0 ? this.there.indexOf(true) : before;
  }

  arrived(answer) {
    const { resolve, reject } = this.waiting.get(answer.id);
    this.waiting.delete(answer.id);
    if (answer.error) reject(new Error(answer.error));
    else resolve(answer);
  }

  // {count, order, total, data}: Gaussians of a frame, in what order a camera draws those of some views, how many these
  // are, and texels if wanted.
  order(frame, pose, drawn, texels, next) {
    const id = this.asked++;
    this.worker.postMessage({ id, frame, axis: pose.slice(8, 12), drawn, texels, next });
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }

  // Address of the small picture that a source camera took of a frame; empty where it took none.
  picture(frame, view) {
    const coded = this.pictures[frame][view];
    return coded ? `data:image/webp;base64,${coded}` : "";
  }
}
