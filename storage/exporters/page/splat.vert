#version 300 es
// A Gaussian as a parallelogram of four corners: the definition of stages/splatting/definition/projection.py.
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D splats;    // two texels a Gaussian, 1024 a row: see lift() in decode.js
uniform usampler2D order;     // which Gaussian is drawn when, 2048 a row
uniform mat4 pose;            // world to camera, metres; x right, y down, z forward
uniform vec3 centre;          // of the camera in the world
uniform vec4 lens;            // fx, fy, cx, cy in px; the centre of the first pixel is (0.5, 0.5)
uniform float skew;           // px
uniform vec2 size;            // of the picture, px
uniform float weights[128];   // of every source view, 0..1
uniform bool allSides;        // whether opacity is the same from everywhere
uniform float lowPass;        // px^2, added to both axes; opacity loses as much
uniform float near;           // metres
uniform float frustumMargin;
uniform float varianceMin;
uniform float compensationMin;
uniform float alphaMin;

out vec3 color;
out float opacity;
out vec2 whitened;            // the place in standard deviations: alpha falls by exp(-|whitened|^2 / 2)

mat3 axes(vec4 q) {
  vec3 v = q.yzw;
  vec3 d = v * v;
  vec3 m = vec3(v.y * v.z, v.x * v.z, v.x * v.y);
  vec3 w = q.x * v;
  return mat3(
    1.0 - 2.0 * (d.y + d.z), 2.0 * (m.z + w.z), 2.0 * (m.y - w.y),
    2.0 * (m.z - w.z), 1.0 - 2.0 * (d.x + d.z), 2.0 * (m.x + w.x),
    2.0 * (m.y + w.y), 2.0 * (m.x - w.x), 1.0 - 2.0 * (d.x + d.y));
}

float shown(float faceOn, float grazing, vec3 normal, vec3 mean) {
  if (allSides) return faceOn;
  float cosine = dot(normal, normalize(centre - mean));
  return cosine > 0.0 ? mix(grazing, faceOn, cosine) : 0.0;
}

void main() {
  int turn = gl_VertexID >> 2;  // four corners each; instances would take a draw each where there is no GPU
  uint which = texelFetch(order, ivec2(turn & 2047, turn >> 11), 0).r;
  ivec2 at = ivec2(int(which & 1023u) * 2, int(which >> 10u));
  uvec4 place = texelFetch(splats, at, 0);
  uvec4 shape = texelFetch(splats, at + ivec2(1, 0), 0);
  vec3 mean = uintBitsToFloat(place.xyz);
  vec3 p = (pose * vec4(mean, 1.0)).xyz;
  gl_Position = vec4(2.0, 2.0, 0.0, 1.0);  // four corners in one place outside: nothing is drawn
  if (!(p.z > near)) return;

  mat3 rotation = axes(normalize(vec4(unpackSnorm2x16(shape.x), unpackSnorm2x16(shape.y))));
  vec3 scale = exp2((vec3(shape.z & 65535u, shape.z >> 16u, shape.w & 65535u) - 32768.0) / 1024.0);
  opacity = shown(float(shape.w >> 16u & 255u) / 255.0, float(shape.w >> 24u) / 255.0, rotation[2], mean);
  opacity *= weights[place.w >> 24u];
  if (opacity < alphaMin) return;

  vec2 f = lens.xy, c = lens.zw, margin = frustumMargin * 0.5 * size / f;
  vec2 slope = clamp(p.xy / p.z, -c / f - margin, (size - c) / f + margin);
  mat3 b = transpose(mat3(pose) * mat3(rotation[0] * scale.x, rotation[1] * scale.y, rotation[2] * scale.z));
  vec3 dx = (b[0] - slope.x * b[2]) / p.z, dy = (b[1] - slope.y * b[2]) / p.z;
  vec3 m0 = f.x * dx + skew * dy, m1 = f.y * dy;
  vec3 across = cross(m0, m1);  // its square is the determinant, which cannot cancel
  float a = dot(m0, m0), bc = dot(m0, m1), d = dot(m1, m1), sharp = dot(across, across);
  float det = sharp + lowPass * (a + d) + lowPass * lowPass;
  a += lowPass;
  d += lowPass;
  if (!(det > varianceMin * (a + d))) return;
  if (lowPass > 0.0) opacity *= sqrt(max(sharp / det, compensationMin * compensationMin));
  if (opacity < alphaMin) return;

  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  whitened = corner * sqrt(2.0 * log(opacity / alphaMin));
  // the root of the covariance, with the larger axis as pivot
  float pivot = sqrt(max(a, d)), rest = sqrt(det) / pivot;
  vec2 along = vec2(pivot * whitened.x, bc / pivot * whitened.x + rest * whitened.y);
  vec2 seen = vec2(f.x * p.x + skew * p.y, f.y * p.y) / p.z + c + (a >= d ? along : along.yx);
  gl_Position = vec4(seen.x / size.x * 2.0 - 1.0, 1.0 - seen.y / size.y * 2.0, 0.0, 1.0);

  color = vec3(place.w & 255u, place.w >> 8u & 255u, place.w >> 16u & 255u) / 255.0;
}
