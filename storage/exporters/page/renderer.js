// Gaussians in a canvas by WebGL2: texels and an order of drawing in, a picture out.

const TEXELS = 2048, ROOM = 1 << 28;

function compiled(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

function linked(gl, vertex, fragment) {
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

class Renderer {
  constructor(canvas, vertex, fragment, cutoffs) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (!gl) throw new Error("This browser has no WebGL2. Chrome, Firefox, Edge and Safari of 2022 or later have it.");
    this.gl = gl;
    this.program = linked(gl, vertex, fragment);
    this.textures = new Map();  // by frame, the latest used last
    this.count = this.cornered = 0;
    gl.useProgram(this.program);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.uniform1i(this.at("order"), 1);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (const [name, value] of Object.entries(cutoffs)) gl.uniform1f(this.at(name), value);
  }

  at(name) {
    return this.gl.getUniformLocation(this.program, name);
  }

  has(frame) {
    return this.textures.has(frame);
  }

  // Gives up a frame that has come anew.
  forget(frame) {
    this.gl.deleteTexture(this.textures.get(frame)?.texture ?? null);
    this.textures.delete(frame);
  }

  // Takes a frame's texels, of `count` Gaussians; the frames that were drawn longest ago make room. Throws Error for
  // more than a texture has rows for, of which nothing would be drawn.
  keep(frame, data, count) {
    const { gl } = this, most = (TEXELS / 2) * gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (count > most) {
      const told = `a frame has ${count} Gaussians, this device holds ${most}`;
      throw new Error(`${told}; export with --page-gaussians ${Math.floor(0.9 * most)}.`);  // which is kept to, about
    }
    let held = data.byteLength;
    for (const t of this.textures.values()) held += t.bytes;
    for (const [old, t] of this.textures) {
      if (held <= ROOM) break;
      gl.deleteTexture(t.texture);
      this.textures.delete(old);
      held -= t.bytes;
    }
    const texture = this.table(gl.RGBA32UI, gl.RGBA_INTEGER, data, 4);
    this.textures.set(frame, { texture, bytes: data.byteLength });
  }

  // Takes an order of drawing: whole rows, of which the first `count` numbers are meant.
  sort(order, count) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE1);
    gl.deleteTexture(this.order);
    this.order = this.table(gl.R32UI, gl.RED_INTEGER, order, 1);
    gl.activeTexture(gl.TEXTURE0);
    this.count = count;
    if (count > this.cornered) this.corner(count);
  }

  // Two triangles for each of `count` Gaussians.
  corner(count) {
    const corners = new Uint32Array(6 * count);
    for (let i = 0, k = 0, v = 0; i < count; i++, v += 4) {
      for (const c of [0, 1, 2, 2, 1, 3]) corners[k++] = v + c;
    }
    this.gl.bufferData(this.gl.ELEMENT_ARRAY_BUFFER, corners, this.gl.STATIC_DRAW);
    this.cornered = count;
  }

  // A texture of whole rows of whole numbers, `channels` a texel.
  table(inside, format, data, channels) {
    const { gl } = this, texture = gl.createTexture(), rows = data.length / channels / TEXELS;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {  // whole numbers have no other
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    gl.texStorage2D(gl.TEXTURE_2D, 1, inside, TEXELS, rows);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXELS, rows, format, gl.UNSIGNED_INT, data);
    return texture;
  }

  // A frame before a colour [r, g, b] 0..1; a frame that is not there yet leaves the background.
  draw(frame, camera, weights, lowPass, allSides, background) {
    const { gl } = this, kept = this.textures.get(frame), { lens, pose, size } = camera;
    gl.viewport(0, 0, ...size);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!kept) return;
    this.textures.delete(frame);
    this.textures.set(frame, kept);
    gl.bindTexture(gl.TEXTURE_2D, kept.texture);
    const columns = [0, 1, 2, 3].flatMap((c) => [pose[c], pose[4 + c], pose[8 + c], Number(c === 3)]);
    gl.uniformMatrix4fv(this.at("pose"), false, columns);
    gl.uniform3fv(this.at("centre"), centreOf(pose));
    gl.uniform4f(this.at("lens"), lens[0], lens[3], lens[2], lens[4]);
    gl.uniform1f(this.at("skew"), lens[1]);
    gl.uniform2f(this.at("size"), ...size);
    gl.uniform1fv(this.at("weights"), weights);
    gl.uniform1f(this.at("lowPass"), lowPass);
    gl.uniform1i(this.at("allSides"), Number(allSides));
    gl.drawElements(gl.TRIANGLES, 6 * this.count, gl.UNSIGNED_INT, 0);
  }
}
