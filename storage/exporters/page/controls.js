// Buttons, menus and keys. Every text that comes from a capture goes in as text, never as markup.

const KEYS_HELP = [
  ["drag", "turn"], ["right drag, shift drag, two fingers", "shift"], ["wheel, pinch, + and −", "zoom"],
  ["space", "play or pause"], ["left, right", "a frame back or on (paused)"], ["home, end", "first or last frame"],
  ["shift and arrows", "turn"], ["[ and ]", "slower, faster"], ["c", "next camera"], ["r, double click", "back"],
  ["p", "picture of a source camera"], ["b", "background"], ["s", "save the picture"], ["i, ?", "info, keys"],
  ["f", "full screen"],
];

const megabytes = (bytes) => `${(bytes / 1e6).toFixed(1)} MB`;
const grouped = (count) => count.toLocaleString("en");
const element = (id) => document.getElementById(id);

function listed(rows) {
  const list = document.createElement("dl");
  for (const [term, text] of rows) {
    list.append(Object.assign(document.createElement("dt"), { textContent: term }));
    list.append(Object.assign(document.createElement("dd"), { textContent: text }));
  }
  return list;
}

function panel(id, title, rows) {
  const heading = Object.assign(document.createElement("h1"), { textContent: title });
  element(id).replaceChildren(heading, listed(rows));
}

function option(value, text) {
  return Object.assign(document.createElement("option"), { value, textContent: text });
}

class Controls {
  constructor(player, movement) {
    Object.assign(this, { player, movement, head: player.head });
    this.fill();
    this.listen();
    player.listeners.push(() => this.update());
    panel("help", "Keys, mouse and touch", KEYS_HELP);
    player.paint(this.head.background);
    if (this.head.steps < 2) element("play").disabled = true;
  }

  fill() {
    const { head } = this, groups = new Map();
    head.cameras.forEach((camera, i) => {
      if (!groups.has(camera.group)) groups.set(camera.group, document.createElement("optgroup"));
      groups.get(camera.group).append(option(i, camera.name));
    });
    for (const [name, group] of groups) element("camera").append(Object.assign(group, { label: name }));
    element("camera").append(option("free", "free"));
    element("speed").append(...SPEEDS.map((speed) => option(speed, `${speed}×`)));
    element("pip").append(option("off", "off"), option("nearest", "nearest"));
    element("pip").append(...head.views.map((view, v) => option(v, view.name)));
    element("speed").value = "1";
    element("scrub").max = head.steps - 1;
  }

  listen() {
    const { player } = this, on = (id, event, act) => element(id).addEventListener(event, act);
    on("play", "click", () => player.play(!player.playing));
    on("scrub", "input", (e) => {
      const step = Number(e.target.value);  // before pausing sets it to where the player is
      player.play(false);
      player.seek(step);
    });
    on("camera", "change", (e) => e.target.value !== "free" && player.choose(Number(e.target.value)));
    on("speed", "change", (e) => (player.speed = Number(e.target.value)));
    on("pip", "change", () => this.update());
    on("background", "input", (e) => player.paint(e.target.value));
    on("reset", "click", () => player.reset());
    on("save", "click", () => this.save());
    on("full", "click", () => this.full());
    on("info-button", "click", () => this.toggle("info"));
    on("help-button", "click", () => this.toggle("help"));
    window.addEventListener("keydown", (e) => this.key(e));
  }

  toggle(id) {
    for (const other of ["info", "help"]) element(other).hidden = other !== id || !element(other).hidden;
    this.update();
  }

  save() {
    const name = `${this.head.title}-${this.head.frames[this.player.frame]}.png`.replace(/[^\w.-]+/g, "_");
    Object.assign(document.createElement("a"), { href: this.player.picture(), download: name }).click();
  }

  full() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen?.();
  }

  // Another entry of a menu, and what the menu does.
  next(id, by = 1) {
    const menu = element(id), count = menu.options.length;
    const at = menu.selectedIndex + by;
    menu.selectedIndex = id === "speed" ? Math.max(0, Math.min(count - 1, at)) : at % count;
    menu.dispatchEvent(new Event("change"));
  }

  key(event) {
    const { player } = this, typing = event.target.matches("select, input[type=color]");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const turns = event.shiftKey && event.key.startsWith("Arrow");
    const act = turns ? this.turning(event.key) : this.keys()[event.key.toLowerCase()];
    if (!act || (event.key === " " && event.target.matches("button"))) return;
    event.preventDefault();
    act();
  }

  turning(key) {
    const [right, down] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
    return () => this.movement.turn(right * KEY_TURN, down * KEY_TURN);
  }

  keys() {
    const { player, movement } = this, seek = (step) => (player.play(false), player.seek(step));
    return {
      " ": () => player.play(!player.playing), home: () => seek(0), end: () => seek(this.head.steps - 1),
      arrowleft: () => seek(player.step - 1), arrowright: () => seek(player.step + 1),
      "+": () => movement.zoom(0.9), "=": () => movement.zoom(0.9), "-": () => movement.zoom(1 / 0.9),
      "[": () => this.next("speed", -1), "]": () => this.next("speed"),
      c: () => player.choose(player.free ? 0 : (player.choice + 1) % this.head.cameras.length), r: () => player.reset(),
      p: () => this.next("pip"), b: () => this.repaint(), s: () => this.save(), i: () => this.toggle("info"),
      "?": () => this.toggle("help"), f: () => this.full(),
    };
  }

  repaint() {
    const at = BACKGROUNDS.indexOf(this.player.background);
    this.player.paint(BACKGROUNDS[(at + 1) % BACKGROUNDS.length]);
  }

  update() {
    const { player, head } = this, seconds = head.times[player.step].toFixed(2);
    element("play").textContent = player.playing ? "❚❚" : "▶";
    element("scrub").value = player.step;
    const shown = player.frame < 0 ? "no frame yet" : `frame ${head.frames[player.frame]}`;
    element("time").textContent = `${shown} · ${seconds} s`;
    element("camera").value = player.free ? "free" : player.choice;
    element("background").value = player.background;
    element("info-button").setAttribute("aria-pressed", !element("info").hidden);
    element("help-button").setAttribute("aria-pressed", !element("help").hidden);
    if (!element("info").hidden) panel("info", head.title, [...head.info, ...this.measured()]);
    this.showSource();
  }

  measured() {
    const { player } = this;
    return [
      ["Gaussians", `${grouped(player.count)} in this frame, ${grouped(player.renderer.count)} drawn`],
      ["Size", `${megabytes(player.sequence.bytes)} of coded frames and pictures`],
      ["Drawn", `${player.canvas.width} × ${player.canvas.height} px, ${player.rate} pictures in the last second`],
    ];
  }

  showSource() {
    const { player, head } = this, wanted = player.shown < 0 ? "off" : element("pip").value;
    const view = wanted === "off" ? -1 : wanted === "nearest" ? player.nearest() : Number(wanted);
    const address = view < 0 ? "" : player.sequence.picture(player.shown, view);
    element("source").hidden = !address;
    if (!address || address === this.address) return;
    this.address = address;
    element("source-picture").src = address;
    element("source-name").textContent = head.views[view].name;
  }
}
