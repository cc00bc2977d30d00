// A page that is served: frames come as they are finished. Beside the page lie `state.json`, {version, frames: a key
// that changes with what a frame holds, null for one that is not there}, and `frames/N`, {key, coded, pictures}.

const POLL_MS = 1500;

class Live {
  constructor(player) {
    this.player = player;
    this.held = player.head.frames.map(() => null);
    this.line = Object.assign(document.createElement("p"), { id: "live" });
    this.line.setAttribute("role", "status");
    this.said = document.createElement("span");
    this.line.append(this.said, " ", Object.assign(document.createElement("a"), { href: "../", textContent: "all sequences" }));
    document.querySelector("footer").prepend(this.line);
    this.message = document.getElementById("message");
    player.listeners.push(() => this.unveil());
    this.poll();
  }

  // The word over the empty canvas goes with the first picture; an error stays.
  unveil() {
    if (this.player.shown >= 0 && !this.message.className) this.message.hidden = true;
  }

  async poll() {
    try {
      const state = await this.asked("state.json");
      if (state.version !== this.player.head.version) return location.reload();  // other cameras, frames or effects
      await this.take(state.frames);
      this.say(state.frames);
    } catch (error) {
      this.said.textContent = `${error.message}; asked again every ${POLL_MS / 1000} s.`;
    }
    setTimeout(() => this.poll(), POLL_MS);
  }

  async asked(address) {
    const answer = await fetch(address, { cache: "no-store" }).catch(() => null);
    if (!answer) throw new Error("The server does not answer: `posegaussian view` has ended, or the way to it");
    if (!answer.ok) throw new Error((await answer.text()).trim());
    return answer.json();
  }

  // Fetches what is new, one frame after the other, and shows each as it comes.
  async take(keys) {
    for (const [frame, key] of keys.entries()) {
      if (!key || key === this.held[frame]) continue;
      const found = await this.asked(`frames/${frame}`);
      do await this.player.idle; while (this.player.busy);  // what is under way is of the frame as it was
      this.held[frame] = found.key;
      this.player.put(frame, found.coded, found.pictures);
      this.say(keys);
    }
  }

  say(keys) {
    const here = this.held.filter(Boolean).length, again = keys.filter((key, f) => !key && this.held[f]).length;
    const all = keys.length, frames = all === 1 ? "frame" : "frames";
    const old = again ? ` ${again} of them made anew just now, shown as before.` : "";
    this.said.textContent = `Live: ${here} of ${all} ${frames}.${old}`;
    if (!here && !this.message.className) this.message.textContent = "No frame is finished yet; the first one shows by itself.";
  }
}

started.then(() => {
  if (window.posegaussian) window.posegaussian.live = new Live(window.posegaussian);
});
