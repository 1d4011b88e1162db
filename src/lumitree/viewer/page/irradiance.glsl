// Illuminance of the walls, sum over cells of I(direction) cos / distance^2.
uniform sampler2D cells;       // per cell: lower corner and largest intensity; upper corner
uniform sampler2D intensity;   // relative intensities, cell by cell, R^2 bins
uniform int num_cells, bins, samples, patches;
uniform vec3 room;             // half sides of the box
out vec4 lux;

ivec2 texel(int i) { return ivec2(i & 4095, i >> 12); }

// Place beyond the map: each side meets its own other half.
vec2 on_map(vec2 u) {
  if (abs(u.x) > 1.0) u = vec2((u.x < 0.0 ? -2.0 : 2.0) - u.x, -u.y);
  if (abs(u.y) > 1.0) u = vec2(-u.x, (u.y < 0.0 ? -2.0 : 2.0) - u.y);
  return u;
}

// Place on the map of a direction: edges of the octahedron are bevelled, see core.octahedral.
vec2 octahedral(vec3 v) {
  vec3 a = abs(v);
  float width = 1.0 / float(bins), half_ = 0.5 * float(bins);
  float strip = (max(a.x, a.y) + a.z) / (1.0 - width);
  vec2 p = a.xy / max(max(a.x + a.y + a.z, strip), a.z / (1.0 - 2.0 * width));
  // Where z is 0, the surface between four middles of bins is a hyperbolic paraboloid.
  vec2 first = floor(p * half_ - 0.5);
  if (first.x + first.y + 2.0 == half_ && min(first.x, first.y) >= 0.0) {
    vec2 st = p * half_ - 0.5 - first, slope = 1.0 - 2.0 * p;
    float product = st.x * st.y, b = 1.0 - st.x * slope.y - st.y * slope.x;
    float root = sqrt(max(b * b - 4.0 * slope.x * slope.y * product, 0.0));
    p += 4.0 * width * product / (b + root) * slope;
  }
  if (v.z < 0.0) p = 1.0 - p.yx;
  return vec2(v.x < 0.0 ? -p.x : p.x, v.y < 0.0 ? -p.y : p.y);
}

// Bin of a direction, moved on the map by an offset from -1/2 to 1/2 bins: over all offsets, the
// mean intensity is linear between the middles of bins.
int bin_of(vec3 v, vec2 offset) {
  vec2 u = octahedral(v);
  u = on_map(u + offset * (2.0 / float(bins)));
  ivec2 b = clamp(ivec2((u + 1.0) * (0.5 * float(bins))), 0, bins - 1);
  return b.y * bins + b.x;
}

void main() {
  // Walls -x, +x, -y, +y, -z, +z beside each other; each by its other two axes in rising order.
  ivec2 at = ivec2(gl_FragCoord.xy);
  int wall = at.x / patches, axis = wall >> 1;
  vec2 uv = 2.0 * (vec2(at.x % patches, at.y) + 0.5) / float(patches) - 1.0;
  float sign_ = (wall & 1) == 1 ? 1.0 : -1.0;
  vec3 x = room * (axis == 0 ? vec3(sign_, uv) : axis == 1 ? vec3(uv.x, sign_, uv.y) : vec3(uv, sign_));
  float total = 0.0;
  for (int i = 0; i < num_cells; ++i) {
    vec4 lower = texelFetch(cells, texel(2 * i), 0);
    vec3 upper = texelFetch(cells, texel(2 * i + 1), 0).xyz;
    float sum = 0.0;
    for (int k = 0; k < samples; ++k) {
      // Points of the R3 and R2 sequences, rotated for each cell; one sample: the centre.
      float number = float(k + 1 + (i & 1023) * samples);
      vec3 f = samples == 1 ? vec3(0.5) : fract(vec3(0.8191725, 0.6710436, 0.5497005) * number);
      vec2 offset = samples == 1 ? vec2(0) : fract(vec2(0.7548777, 0.5698403) * number) - 0.5;
      vec3 v = x - mix(lower.xyz, upper, f);
      float r2 = dot(v, v);
      float cosine = abs(v[axis]) * inversesqrt(r2);
      sum += texelFetch(intensity, texel(i * bins * bins + bin_of(v, offset)), 0).r * cosine / r2;
    }
    total += sum * lower.w;
  }
  lux = vec4(total / float(samples), 0, 0, 1);
}
