#version 300 es
precision highp float;

uniform float alphaMin;
uniform float alphaMax;

in vec3 color;
in float opacity;
in vec2 whitened;
out vec4 premultiplied;

void main() {
  float alpha = min(opacity * exp(-0.5 * dot(whitened, whitened)), alphaMax);
  if (alpha < alphaMin) discard;
  premultiplied = vec4(color * alpha, alpha);
}
