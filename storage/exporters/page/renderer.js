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
    this.order = gl.createBuffer();
    this.count = 0;
    gl.useProgram(this.program);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    const which = gl.getAttribLocation(this.program, "which");
    gl.enableVertexAttribArray(which);
    gl.vertexAttribIPointer(which, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(which, 1);
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

  // Takes a frame's texels; the frames that were drawn longest ago make room.
  keep(frame, data) {
    const { gl } = this, rows = data.length / 4 / TEXELS;
    let held = data.byteLength;
    for (const t of this.textures.values()) held += t.bytes;
    for (const [old, t] of this.textures) {
      if (held <= ROOM) break;
      gl.deleteTexture(t.texture);
      this.textures.delete(old);
      held -= t.bytes;
    }
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {  // whole numbers have no other
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, TEXELS, rows);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXELS, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, data);
    this.textures.set(frame, { texture, bytes: data.byteLength });
  }

  sort(order) {
    this.gl.bufferData(this.gl.ARRAY_BUFFER, order, this.gl.STREAM_DRAW);
    this.count = order.length;
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
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}
