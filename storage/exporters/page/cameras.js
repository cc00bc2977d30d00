// Cameras as data: {size: [w, h] px, lens: [fx, skew, cx, fy, cy] px, pose: 12 numbers, world to camera, row by row}.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const axisOf = (pose, row) => [pose[4 * row], pose[4 * row + 1], pose[4 * row + 2]];
const focalOf = ([fx, , , fy]) => (fx + fy) / 2;

function centreOf(pose) {
  return [0, 1, 2].map((i) => -(pose[i] * pose[3] + pose[4 + i] * pose[7] + pose[8 + i] * pose[11]));
}

function poseAt(axes, centre) {
  return axes.flatMap((axis) => [...axis, -dot(axis, centre)]);
}

// The camera as it fills a picture of another size: all of its own picture is seen, in the middle.
function fitted({ size, lens, pose }, width, height) {
  const scale = Math.min(width / size[0], height / size[1]), [fx, skew, cx, fy, cy] = lens.map((n) => n * scale);
  const left = (width - size[0] * scale) / 2, top = (height - size[1] * scale) / 2;
  return { size: [width, height], lens: [fx, skew, cx + left, fy, cy + top], pose };
}

// A vector turned about a unit axis, by radians.
function turned(vector, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(axis, vector) * (1 - c);
  return plus(plus(vector.map((n) => n * c), cross(axis, vector), s), axis, along);
}

// What lies level to the right of someone upright who looks where the camera looks, as a unit vector; the camera's own
// right where it looks straight up or down.
function levelOf(pose, up) {
  const level = cross(axisOf(pose, 2), up), length = Math.hypot(...level);
  return length > 1e-6 ? level.map((n) => n / length) : axisOf(pose, 0);
}

// The camera swung about a point: `yaw` about `up`, then `pitch` about what is level; never over the top, and one that
// is beyond stays there.
function orbited(camera, target, up, yaw, pitch) {
  const axes = [0, 1, 2].map((row) => axisOf(camera.pose, row));
  const height = Math.asin(Math.max(-1, Math.min(1, dot(axes[2], up))));
  const tilt = Math.max(Math.min(-1.5, height), Math.min(Math.max(1.5, height), height + pitch)) - height;
  const right = turned(levelOf(camera.pose, up), up, yaw);
  const swung = (vector) => turned(turned(vector, up, yaw), right, tilt);
  const centre = plus(target, swung(minus(centreOf(camera.pose), target)));
  return { ...camera, pose: poseAt(axes.map(swung), centre) };
}

// The camera nearer to a point, or farther from it.
function dollied(camera, target, factor) {
  const axes = [0, 1, 2].map((row) => axisOf(camera.pose, row));
  return { ...camera, pose: poseAt(axes, plus(target, minus(centreOf(camera.pose), target), factor)) };
}

function shifted(camera, by) {
  const axes = [0, 1, 2].map((row) => axisOf(camera.pose, row));
  return { ...camera, pose: poseAt(axes, plus(centreOf(camera.pose), by)) };
}

// Radians at the subject between each source camera and a place.
function anglesAt(subject, views, centre) {
  const ray = minus(centre, subject);
  return views.map((view) => {
    const own = minus(view.centre, subject), side = cross(own, ray);
    return Math.atan2(Math.hypot(...side), dot(own, ray));
  });
}

// Weight 0..1 of every source view, as stages/rendering/sources.py has it: the nearest `count` in angle, each faded to
// nothing when another takes its place, and where another camera stands.
function weightsFor(head, frame, centre) {
  const usable = head.usable[frame], weights = head.views.map(() => 0);
  if (head.allSides) return usable.map(Number);
  const angles = anglesAt(head.subject, head.views, centre);
  const near = head.views.map((_, v) => v).filter((v) => usable[v]).sort((a, b) => angles[a] - angles[b] || a - b);
  const leftOut = near.length > head.sources ? angles[near[head.sources]] : Math.PI;
  const ring = head.sources > 1 && near.length > 1 ? 2 * angles[near[0]] + angles[near[1]] : Math.PI;
  const limit = Math.min(leftOut, ring);
  const chosen = near.slice(0, head.sources);
  for (const v of chosen) weights[v] = limit > 0 ? Math.sqrt(Math.max(0, 1 - angles[v] / limit)) : 0;
  const most = Math.max(...weights, 0);
  return most > 0 ? weights.map((w) => w / most) : weights.map((_, v) => Number(chosen.includes(v)));
}

// Variance in px^2 that averages a picture which samples the subject more coarsely than its sources: the filter of
// stages/rendering/mip.py, from the ratio on at which the pipeline has it.
function lowPassFor(head, weights, { lens, pose }) {
  const pixel = (centre, focal) => Math.hypot(...minus(centre, head.subject)) / focal;
  const sources = head.views.filter((_, v) => weights[v] > 0).map((view) => pixel(view.centre, focalOf(view.lens)));
  const ratio = pixel(centreOf(pose), focalOf(lens)) / Math.min(...sources);
  return ratio > head.coarse ? (1 - ratio ** -2) / 12 : 0;
}
