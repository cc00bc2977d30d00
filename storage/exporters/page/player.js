// What is shown, and when: a step of time, a camera, a background.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2], BACKGROUNDS = ["#101418", "#000000", "#ffffff", "#808080", "#30a040"];
const MOST_DENSE = 2;

class Player {
  constructor(sequence, canvas) {
    this.sequence = sequence;
    this.head = sequence.head;
    this.canvas = canvas;
    this.renderer = new Renderer(canvas, textOf("splat-vert"), textOf("splat-frag"), this.head.cutoffs);
    this.listeners = [];
    Object.assign(this, { step: 0, playing: false, speed: 1, background: this.head.background, clock: 0, drawn: 0 });
    this.count = 0;
    this.rate = 0;
    this.marks = [];
    this.shown = -1;  // the frame on the canvas
    this.seen = null;  // the camera that it is drawn for
    this.idle = Promise.resolve();
    this.reset();
    new ResizeObserver(() => this.resized()).observe(canvas);
    canvas.addEventListener("webglcontextlost", () => this.failed("the graphics device is gone; load the page again."));
    requestAnimationFrame((now) => this.tick(now));
  }

  // The frame to show, -1 before any is there.
  get frame() {
    return this.sequence.nearest(Math.min(this.step, this.head.frames.length - 1));
  }

  // Takes a frame that has come, or has come anew.
  put(frame, coded, pictures) {
    this.sequence.put(frame, coded, pictures);
    this.renderer.forget(frame);
    this.look();
  }

  changed() {
    for (const listener of this.listeners) listener();
  }

  // The chosen camera of the menu, where it stands now.
  standing() {
    const { size, lens, pose } = this.head.cameras[this.choice];
    const at = (list) => list[Math.min(this.step, list.length - 1)];
    return { size, lens: at(lens), pose: at(pose) };
  }

  choose(choice) {
    this.choice = choice;
    this.camera = this.standing();
    this.target = this.head.target;
    this.distance = Math.hypot(...minus(centreOf(this.camera.pose), this.target));
    this.free = false;
    this.look();
  }

  reset() {
    this.choose(0);
  }

  // Leaves the camera of the menu.
  move(camera) {
    this.camera = camera;
    this.free = true;
    this.look();
  }

  seek(step) {
    this.step = ((step % this.head.steps) + this.head.steps) % this.head.steps;
    this.clock = this.head.times[this.step];
    if (!this.free) this.camera = this.standing();
    this.look();
  }

  play(playing) {
    this.playing = playing && this.head.steps > 1;
    this.changed();
  }

  paint(background) {
    this.background = background;
    this.look();
  }

  resized() {
    const dense = Math.min(window.devicePixelRatio || 1, MOST_DENSE);
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * dense));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * dense));
    this.draw();
    this.look();
  }

  // Something to look at has changed: draw at the next chance, sorted anew.
  look() {
    this.stale = true;
    this.changed();
  }

  tick(now) {
    const past = Math.min(now - (this.now ?? now), 250) / 1000;
    this.now = now;
    if (this.playing) {
      const { times, rate } = this.head;  // seconds; a step is shown until the next one's time, the last a usual while
      this.clock = (this.clock + past * this.speed) % (times.at(-1) + 1 / rate);
      const step = times.findLastIndex((time) => time <= this.clock);
      if (step !== this.step && !this.busy) {
        this.step = step;
        if (!this.free) this.camera = this.standing();
        this.look();
      }
    }
    if (this.stale && !this.busy) this.idle = this.refresh();
    requestAnimationFrame((later) => this.tick(later));
  }

  // Has the frame decoded and sorted for the camera, then draws it.
  async refresh() {
    this.stale = false;
    if (this.frame < 0) return;
    this.busy = true;
    const { frame, head, renderer } = this, { pose } = this.camera;
    const weights = weightsFor(head, frame, centreOf(pose)), next = (frame + 1) % head.frames.length;
    const texels = !renderer.has(frame), drawn = weights.map((w) => w > 0);
    try {
      const ahead = this.playing && this.sequence.there[next] ? next : undefined;
      const { count, order, total, data } = await this.sequence.order(frame, pose, drawn, texels, ahead);
      if (data) renderer.keep(frame, data, count);
      renderer.sort(order, total);
      this.count = count;
      this.shown = frame;
      this.draw();
      this.timed();
      this.changed();
    } catch (error) {
      this.failed(error);
    }
    this.busy = false;
  }

  draw() {
    if (this.frame < 0) return;
    const { head, canvas } = this, camera = fitted(this.camera, canvas.width, canvas.height);
    const weights = weightsFor(head, this.frame, centreOf(camera.pose)), n = parseInt(this.background.slice(1), 16);
    const color = [n >> 16, (n >> 8) & 255, n & 255].map((c) => c / 255);
    this.renderer.draw(this.shown, camera, weights, lowPassFor(head, weights, camera), head.allSides, color);
    this.seen = camera;
    this.drawn++;
  }

  // Pictures a second over the last second.
  timed() {
    const now = performance.now();
    this.marks = [...this.marks.filter((t) => now - t < 1000), now];
    this.rate = this.marks.length;
  }

  // The source view nearest in angle to what is shown, among those that have a picture of the frame; -1 for none.
  nearest() {
    const { head, shown } = this, angles = anglesAt(head.subject, head.views, centreOf(this.seen.pose));
    const seen = angles.map((a, v) => (this.sequence.picture(shown, v) ? a : Infinity));
    const best = seen.indexOf(Math.min(...seen));
    return seen[best] < Infinity ? best : -1;
  }

  // Resolves when what was asked for is on the canvas.
  async settled() {
    do {
      await new Promise(requestAnimationFrame);
      await this.idle;
    } while (this.stale || this.busy);
  }

  // PNG of the canvas as a data address.
  picture() {
    this.draw();
    return this.canvas.toDataURL("image/png");
  }

  failed(error) {
    const message = document.getElementById("message");
    message.textContent = `This page cannot play: ${error.message || error}`;
    message.className = "error";
    message.hidden = false;
    this.playing = false;
  }
}

async function start() {
  try {
    if (typeof DecompressionStream === "undefined") throw new Error("the browser lacks DecompressionStream (2023).");
    const player = new Player(new Sequence(), document.getElementById("canvas"));
    window.posegaussian = player;  // for scripts and tests
    new Controls(player, new Movement(player.canvas, player));
    await player.settled();
    if (player.shown >= 0) document.getElementById("message").hidden = true;
  } catch (error) {
    Player.prototype.failed.call({}, error);
  }
}

const started = start();
