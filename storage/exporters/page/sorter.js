// The worker: frames come in coded, and go out as texels and as an order of drawing, farthest first.

const KEYS = 65536, TURNS = 2048, MOST_BYTES = 1 << 28;
let head, coded = [];
const frames = new Map();  // decoded, the latest used last

async function frameOf(number) {
  const frame = frames.get(number) || (await decoded(coded[number], head));
  frames.delete(number);
  frames.set(number, frame);
  let held = 0;
  for (const f of frames.values()) held += f.count * (WORDS * 4 + 13);
  for (const [old, f] of frames) {
    if (held <= MOST_BYTES || old === number) break;
    held -= f.count * (WORDS * 4 + 13);
    frames.delete(old);
  }
  return frame;
}

// The Gaussians of the views that are drawn, in front of the camera, farthest first, by a counting sort of depth;
// `axis` is the third row of the camera's pose. {order: whole rows of the texture, total: how many of it are meant}. Of equal depth the one that is later in the file is drawn first, so
// that the earlier one ends up in front, as in the renderer.
function ordered({ count, mean, views }, axis, drawn) {
  const depth = new Float32Array(count), keys = new Uint16Array(count), [x, y, z, t] = axis;
  let low = Infinity, high = -Infinity, total = 0;
  for (let i = 0, k = 0; i < count; i++, k += 3) {
    const d = drawn[views[i]] ? x * mean[k] + y * mean[k + 1] + z * mean[k + 2] + t : -1;
    depth[i] = d;
    if (d > head.cutoffs.near) {
      if (d < low) low = d;
      if (d > high) high = d;
      total++;
    }
  }
  const starts = new Uint32Array(KEYS + 1), scale = (KEYS - 1) / Math.max(high - low, 1e-9);
  for (let i = 0; i < count; i++) {
    if (!(depth[i] > head.cutoffs.near)) continue;
    keys[i] = (depth[i] - low) * scale;
    starts[keys[i] + 1]++;
  }
  for (let k = 0; k < KEYS; k++) starts[k + 1] += starts[k];
  const order = new Uint32Array(Math.max(1, Math.ceil(total / TURNS)) * TURNS);
  for (let i = 0; i < count; i++) if (depth[i] > head.cutoffs.near) order[total - 1 - starts[keys[i]]++] = i;
  return { order, total };
}

async function answer(message) {
  if (message.head) {
    ({ head, coded } = message);
    return;
  }
  if (message.put !== undefined) {
    coded[message.put] = message.coded;
    frames.delete(message.put);
    return;
  }
  const frame = await frameOf(message.frame), { order, total } = ordered(frame, message.axis, message.drawn);
  const data = message.texels ? frame.data.slice() : null;
  postMessage(
    { id: message.id, frame: message.frame, count: frame.count, order, total, data },
    data ? [order.buffer, data.buffer] : [order.buffer],
  );
  if (message.next !== undefined) await frameOf(message.next);  // while the page draws
}

let last = Promise.resolve();
onmessage = ({ data }) => {
  last = last.then(() => answer(data)).catch((error) => postMessage({ id: data.id, error: String(error) }));
};
