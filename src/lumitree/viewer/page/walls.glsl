// One wall in false colour with isolux lines; linear interpolation between patches.
uniform sampler2D lux, colours;
uniform int wall, patches;
uniform vec4 area;         // left, bottom, width, height of the wall on the canvas, pixels
uniform vec2 flip;        // 1: the axis falls along the canvas
uniform int swap;          // 1: the wall's second axis is horizontal
uniform float lowest, highest;
out vec4 pixel;

float at(ivec2 p) {
  p = clamp(p, ivec2(0), ivec2(patches - 1));
  return texelFetch(lux, ivec2(wall * patches + p.x, p.y), 0).r;
}
float level(float e) {   // number of the isolux line below e: 1, 2, 5, 10, ...
  float decade = floor(log2(e) / log2(10.0)), m = e / pow(10.0, decade);
  return 3.0 * decade + (m < 2.0 ? m - 1.0 : m < 5.0 ? 1.0 + (m - 2.0) / 3.0 : 2.0 + (m - 5.0) / 5.0);
}

void main() {
  vec2 uv = (gl_FragCoord.xy - area.xy) / area.zw;
  uv = mix(uv, 1.0 - uv, flip);
  if (swap == 1) uv = uv.yx;
  vec2 p = uv * float(patches) - 0.5;
  ivec2 i = ivec2(floor(p));
  vec2 f = fract(p);
  float e = mix(mix(at(i), at(i + ivec2(1, 0)), f.x), mix(at(i + ivec2(0, 1)), at(i + 1), f.x), f.y);
  float x = clamp(log(max(e, 1e-20) / lowest) / log(highest / lowest), 0.0, 1.0);
  vec3 c = texture(colours, vec2((x * 255.0 + 0.5) / 256.0, 0.5)).rgb;
  if (e > lowest) {
    float n = level(e), distance_ = abs(fract(n + 0.5) - 0.5) / max(fwidth(n), 1e-6);
    float line = 1.0 - smoothstep(0.5, 1.5, distance_);
    c = mix(c, x > 0.6 ? vec3(0) : vec3(1), 0.75 * line);
  }
  pixel = vec4(c, 1);
}
