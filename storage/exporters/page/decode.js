// From the bytes of a frame to Gaussians in the world: the way back from maps.py. Runs in the worker.
"use strict";

const HEAD_BYTES = 20, ROW = 1024, WORDS = 8;

function bytesOf(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Heads of all views: crop, depth of step 0, a step, number of Gaussians; and where the pictures begin.
function headsOf(bytes, views) {
  const data = new DataView(bytes.buffer), heads = [];
  for (let v = 0, at = 0; v < views; v++, at += HEAD_BYTES) {
    const [left, top, width, height] = [0, 2, 4, 6].map((o) => data.getUint16(at + o, true));
    heads.push({
      left, top, width, height,
      nearest: data.getFloat32(at + 8, true), step: data.getFloat32(at + 12, true),
      count: data.getUint32(at + 16, true),
    });
  }
  return heads;
}

// Numbers of a picture, whole crop: what was foretold by the neighbours plus the differences, which are `low` or folded
// from `low` and `high`. A pixel without a Gaussian repeats its left neighbour, as the encoder has it.
function unfold(head, present, low, high) {
  const { width, height } = head, out = new Uint16Array(width * height);
  for (let y = 0, i = 0, n = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      const left = x ? out[i - 1] : 0;
      if (!(present[i >> 3] & (128 >> (i & 7)))) {
        out[i] = left;
        continue;
      }
      const upper = y ? out[i - width] : 0, corner = x && y ? out[i - width - 1] : 0;
      const smaller = left < upper ? left : upper, larger = left < upper ? upper : left;
      const straight = left + upper - corner;
      const foretold = straight < smaller ? smaller : straight > larger ? larger : straight;
      if (high) {
        const change = low[n] | (high[n] << 8);
        out[i] = foretold + (change & 1 ? -(change + 1) / 2 : change / 2);
      } else {
        out[i] = (foretold + low[n]) & 255;
      }
      n++;
    }
  }
  return out;
}

// The pictures of every view, each [crop], as one array a view in the order of PLANES in maps.py.
function picturesOf(bytes, heads, { turns, shifts }) {
  let at = heads.length * HEAD_BYTES;
  const take = (n) => bytes.subarray(at, (at += n));
  const present = heads.map((h) => take(Math.ceil((h.width * h.height) / 8)));
  const planes = Array.from({ length: 12 + (turns ? 1 : 0) + (shifts ? 2 : 0) }, () => heads.map((h) => take(h.count)));
  return heads.map((head, v) => ({
    present: present[v],
    planes: [
      unfold(head, present[v], planes[0][v], planes[1][v]),
      ...planes.slice(2).map((of) => unfold(head, present[v], of[v])),
    ],
  }));
}

// A unit quaternion (w, x, y, z) of a world-to-camera pose's inverse rotation; pose: 12 numbers, row by row.
function towardsWorld(pose) {
  const [a, b, c, , d, e, f, , g, h, i] = pose;
  const q = [1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i];
  const most = q.indexOf(Math.max(...q)), s = 2 * Math.sqrt(q[most]);
  const pairs = [[h - f, c - g, d - b], [d + b, c + g, h + f]];
  const [[x, y, z], [xy, xz, yz]] = pairs;
  const found = [
    [(s * s) / 4, x, y, z], [x, (s * s) / 4, xy, xz], [y, xy, (s * s) / 4, yz], [z, xz, yz, (s * s) / 4],
  ][most].map((n) => n / s);
  return [found[0], -found[1], -found[2], -found[3]];
}

const float = new Float32Array(1), word = new Uint32Array(float.buffer);
const bits = (value) => ((float[0] = value), word[0]);
const signed = (value) => Math.round(value * 32767) & 65535;

// Gaussians of a view into `out`, from the n-th on; `lens` is the view's [fx, skew, cx, fy, cy].
function lift(out, n, v, head, { present, planes }, view, coding) {
  const [fx, skew, cx, fy, cy] = view.lens, focal = (fx + fy) / 2, pose = view.pose;
  const [qw, qx, qy, qz] = towardsWorld(pose), { mean, views, data } = out;
  const [depth, nx, ny, s0, s1, s2, green, red, blue, face, grazing] = planes;
  const turn = coding.turns && planes[11], [right, down] = coding.shifts ? planes.slice(-2) : [];
  const beside = (plane, i) => 0.5 + (plane ? (plane[i] - coding.shiftZero) / coding.shiftSteps : 0);
  const lengths = (code, z) => Math.round(((code - coding.scaleZero) / coding.scaleSteps + z) * 1024) + 32768;
  const opaque = Array.from({ length: coding.opacitySteps + 1 }, (_, k) => Math.round((k * 255) / coding.opacitySteps));
  for (let y = 0, i = 0; y < head.height; y++) {
    for (let x = 0; x < head.width; x++, i++) {
      if (!(present[i >> 3] & (128 >> (i & 7)))) continue;
      const z = head.nearest * Math.exp(depth[i] * head.step);
      const ry = (head.top + y + beside(down, i) - cy) / fy;
      const rx = (head.left + x + beside(right, i) - cx - skew * ry) / fx;
      const px = rx * z - pose[3], py = ry * z - pose[7], pz = z - pose[11];
      for (let k = 0; k < 3; k++) mean[3 * n + k] = pose[k] * px + pose[4 + k] * py + pose[8 + k] * pz;
      views[n] = v;

      // the normal, unfolded from its octahedron about (0, 0, -1), then the smallest turn that takes that one to it
      let u = (nx[i] / coding.normalSteps) * 2 - 1, w = (ny[i] / coding.normalSteps) * 2 - 1;
      const towards = 1 - Math.abs(u) - Math.abs(w);
      if (towards < 0) {
        const folded = (1 - Math.abs(w)) * (u < 0 ? -1 : 1);
        w = (1 - Math.abs(u)) * (w < 0 ? -1 : 1);
        u = folded;
      }
      const length = Math.hypot(u, w, towards), half = Math.sqrt(2 * (1 + towards / length)) || 1e-9;
      const a = (1 + towards / length) / half, b = w / length / half, c = -u / length / half;
      // (a, b, c, 0) after half a turn about x, which takes (x, -y, -z) to the axes of (0, 0, -1)
      let lw = -b, lx = a, ly = 0, lz = -c;
      if (turn) {
        const angle = (turn[i] / coding.turnSteps) * Math.PI, cos = Math.cos(angle), sin = Math.sin(angle);
        [lw, lx, ly, lz] = [lw * cos - lz * sin, lx * cos + ly * sin, ly * cos - lx * sin, lz * cos + lw * sin];
      }
      const at = WORDS * n, octave = Math.log2(z / focal);
      data[at] = bits(mean[3 * n]);
      data[at + 1] = bits(mean[3 * n + 1]);
      data[at + 2] = bits(mean[3 * n + 2]);
      const g = green[i];
      data[at + 3] = ((red[i] + g - 128) & 255) | (g << 8) | (((blue[i] + g - 128) & 255) << 16) | (v << 24);
      const qa = qw * lw - qx * lx - qy * ly - qz * lz, qb = qw * lx + qx * lw + qy * lz - qz * ly;
      const qc = qw * ly - qx * lz + qy * lw + qz * lx, qd = qw * lz + qx * ly - qy * lx + qz * lw;
      data[at + 4] = signed(qa) | (signed(qb) << 16);
      data[at + 5] = signed(qc) | (signed(qd) << 16);
      data[at + 6] = lengths(s0[i], octave) | (lengths(s1[i], octave) << 16);
      data[at + 7] = lengths(s2[i], octave) | (opaque[face[i]] << 16) | (opaque[grazing[i]] << 24);
      n++;
    }
  }
  return n;
}

// {count, mean [3 n] metres in the world, views [n], data: texels of splat.vert, whole rows of a texture}
async function decoded(base64, head) {
  const bytes = await inflated(bytesOf(base64)), heads = headsOf(bytes, head.views.length);
  const count = heads.reduce((sum, h) => sum + h.count, 0), rows = Math.max(1, Math.ceil(count / ROW));
  const out = {
    count, mean: new Float32Array(3 * count), views: new Uint8Array(count), data: new Uint32Array(rows * ROW * WORDS),
  };
  const pictures = picturesOf(bytes, heads, head.coding);
  pictures.reduce((n, p, v) => lift(out, n, v, heads[v], p, head.views[v], head.coding), 0);
  return out;
}
