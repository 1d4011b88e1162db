// Tone mapping of the field, and false colour of its properties.
uniform sampler2D radiance, seen, soft, details, background, colours;
uniform vec2 resolution;
uniform float gain, max_density, tree_depth, studio_backdrop, brightness;
uniform int mode, curve, backdrop, modelled;   // radiance, opacity, density, level; linear, ACES, AgX
const int STUDIO = 3;
out vec4 pixel;

vec3 decode(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }

// Fit of the ACES RRT and ODT by S. Hill.
vec3 aces(vec3 c) {
  const mat3 before = mat3(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777);
  const mat3 after = mat3(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602);
  c = before * c;
  c = (c * (c + 0.0245786) - 0.000090537) / (c * (0.983729 * c + 0.4329510) + 0.238081);
  return encode(after * c);
}

vec3 behind(vec2 uv) {
  if (backdrop == 0) return vec3(0);
  if (backdrop == 1) return vec3(0.18);
  vec2 size = vec2(textureSize(background, 0));
  float wide = resolution.x / resolution.y * size.y / size.x;
  uv = (uv - 0.5) * vec2(min(wide, 1.0), min(1.0 / wide, 1.0)) + 0.5;
  return decode(texture(background, vec2(uv.x, 1.0 - uv.y)).rgb);
}

vec3 false_colour(float x) { return texture(colours, vec2((clamp(x, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb; }

void main() {
  vec2 uv = gl_FragCoord.xy / resolution;
  vec4 l = texture(radiance, uv), d = texture(details, uv);
  vec3 c;
  if (mode == 0) {
    vec3 linear = l.rgb * gain;
    if (backdrop == STUDIO) {
      vec3 lit = modelled != 0 ? texture(soft, uv).rgb : vec3(studio_backdrop * l.a);
      linear += brightness * lit;
    } else linear += (modelled != 0 ? texture(seen, uv).rgb : vec3(l.a)) * behind(uv);
    c = curve == 0 ? encode(linear) : curve == 1 ? aces(linear) : encode(agx(linear));
  } else if (mode == 1) c = vec3(1.0 - l.a);
  else if (d.z == 0.0) c = vec3(0.06);
  else if (mode == 2) c = false_colour(1.0 + log(max(d.x, 1e-20) / max_density) / log(1e4));
  else c = false_colour(d.y / tree_depth);
  pixel = vec4(c, 1);
}
