// Mouse, touch and keys that move the camera. Everything turns about one point of the subject, which panning shifts.

const TURN = 0.006, KEY_TURN = 0.06, WHEEL = 0.0012;

class Movement {
  constructor(canvas, player) {
    this.canvas = canvas;
    this.player = player;
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.moved(e));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (e) => this.pointers.delete(e.pointerId));
    }
    canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("dblclick", () => player.reset());
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (this.pointers.size > 1) this.pinched(event.pointerId, before, now);
    else if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) this.pan(dx, dy);
    else this.turn(dx * TURN, dy * TURN);
    this.pointers.set(event.pointerId, now);
  }

  // One of two fingers moved: their distance zooms, the way of their middle pans.
  pinched(id, before, now) {
    const other = [...this.pointers].find(([key]) => key !== id)[1];
    const apart = (p) => Math.max(1, Math.hypot(p[0] - other[0], p[1] - other[1]));
    this.zoom(apart(before) / apart(now));
    this.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
  }

  wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(event.deltaY * (event.deltaMode ? 20 : 1) * WHEEL));
  }

  // Radians by which the subject turns to the right and tips towards the viewer, as the picture is held: of a camera that
  // lies on its side a way across the picture is a way up the subject.
  turn(right, down) {
    const { player } = this, { pose } = player.camera, { up } = player.head, level = levelOf(pose, up);
    const c = dot(level, axisOf(pose, 0)), s = dot(level, axisOf(pose, 1));
    player.move(orbited(player.camera, player.target, up, -(right * c + down * s), right * s - down * c));
  }

  zoom(factor) {
    const { player } = this, away = Math.hypot(...minus(centreOf(player.camera.pose), player.target));
    const bounded = Math.max(0.05 * player.distance, Math.min(8 * player.distance, away * factor));
    player.move(dollied(player.camera, player.target, bounded / away));
  }

  // By CSS px: what is as far away as the target stays under the finger.
  pan(dx, dy) {
    const { player } = this, { pose } = player.camera;
    const shown = fitted(player.camera, this.canvas.clientWidth, this.canvas.clientHeight);
    const metres = dot(minus(player.target, centreOf(pose)), axisOf(pose, 2)) / focalOf(shown.lens);
    const by = plus(axisOf(pose, 0).map((n) => -n * dx * metres), axisOf(pose, 1), -dy * metres);
    player.target = plus(player.target, by);
    player.move(shifted(player.camera, by));
  }
}
