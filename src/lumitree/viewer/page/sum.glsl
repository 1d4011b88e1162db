// Layers times their gains, in one pass; or, for a pointer, the light of each layer around a pixel.
uniform mediump sampler2DArray light;    // radiance, relative to white, and share that is seen; last, the correction
uniform mediump sampler2DArray levels;   // radiance of emitters that are seen, relative to white
uniform vec3 gain[COUNT];
uniform float exposure, most;    // factor; and largest radiance of emitters, relative to display white
uniform int has_levels;
uniform vec2 pointer;
layout(location = 0) out vec4 rest;      // light without emitters brighter than `most`
layout(location = 1) out vec4 clamped;   // these, clamped

float grey(vec3 c) { return (c.r + c.g + c.b) / 3.0; }

void main() {
#ifdef PROBE
  int layer = int(gl_FragCoord.x);
  vec3 sum = vec3(0);
  ivec2 last = textureSize(light, 0).xy - 1;
  for (int i = 0; i < 25; ++i) sum += texelFetch(light, ivec3(clamp(ivec2(pointer) + ivec2(i % 5, i / 5) - 2, ivec2(0), last), layer), 0).rgb;
  rest = vec4(sum * gain[layer], 1);
#else
  ivec2 p = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0), seen = vec3(0);
  float square = 0.0;
  for (int i = 0; i < COUNT; ++i) {
    vec4 of_layer = texelFetch(light, ivec3(p, i), 0);
    vec3 scaled = of_layer.rgb * gain[i];
    sum += scaled;
    if (of_layer.a > 0.0) {
      float change = grey(scaled) / max(grey(of_layer.rgb), 1e-20);
      seen += scaled * of_layer.a;
      square += grey(scaled) * of_layer.a * change * texelFetch(levels, ivec3(p, i), 0).r;
    }
  }
  float level = exposure * square / max(grey(seen), 1e-20);
  vec3 factor = exposure * texelFetch(light, ivec3(p, COUNT), 0).rgb;
  bool beyond = has_levels != 0 && level > most;
  rest = vec4(factor * (beyond ? max(sum - seen, 0.0) : sum), 1);
  clamped = vec4(beyond ? factor * seen * (most / level) : vec3(0), 1);
#endif
}
