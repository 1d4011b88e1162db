// One path for each pixel through the geometry of the lamp, averaged with those before it.
// Rays are followed through glass and from metals; elsewhere they end, with the mean radiance that the
// surface sends out (lumitree.viewer.surfaces). After a rough metal glass bends no ray, so that
// emitters behind it can be sampled, as in the integrator `lumitree_path`.
uniform isampler2D triangles;   // vertices and surface
uniform sampler2D vertices;     // position; normal; and in w the place on the image of the pattern
uniform sampler2D light;        // radiance of the front; of the back; relative to the largest
uniform sampler2D soft_light;   // the same by the light of the studio; relative to white
uniform sampler2D boxes;        // lower corner; upper corner; of leaves the first triangle, and the next one's
uniform sampler2D surfaces;     // five texels, see Surface.numbers
uniform sampler2D lights;       // of triangles that emit: sum of the power up to it, relative; number
uniform mediump sampler2DArray patterns;
uniform sampler2D previous, previous_seen, previous_soft;   // the image so far
uniform vec3 softboxes[16];     // of each: half of two sides, direction of the light, middle
uniform float softbox, studio_backdrop;   // radiance, relative to white
uniform int num_lights;
uniform float power;            // of these triangles: luminance times area
uniform int depth, sample_;     // of the tree's leaves; number of the sample
uniform vec3 eye;
uniform mat3 camera;            // columns: right, up, forward
uniform vec2 half_field;        // tangents of half the field of view
uniform vec2 resolution;
layout(location = 0) out vec4 radiance;   // radiance / largest; mean share of the light behind that is seen
layout(location = 1) out vec4 seen;       // this share by colour
layout(location = 2) out vec4 soft;       // radiance / white by the light of the studio, its backdrop included

const int GLASS = 1, THIN_GLASS = 2, METAL = 3, HAS_BACK = 1, SMOOTH = 2, BETWEEN_MEDIA = 4, EMITS = 8, GGX = 16;
const int REPEATED = 0, MIRRORED = 1;
const int MAX_VERTICES = 64, ROULETTE_FROM = 8, MAX_CROSSINGS = 32;
// Distance from a surface at which rays begin, local units.
const float ABOVE = 2e-5;
ivec2 texel(int i) { return ivec2(i & 4095, i >> 12); }

uint state;
float random() {   // PCG-RXS-M-XS
  state = state * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return float(((word >> 22u) ^ word) >> 8u) * 5.9604644775390625e-8;
}

struct Hit { float t; int triangle; vec2 uv; };

void meet(vec3 o, vec3 d, int i, inout Hit hit) {
  ivec3 v = texelFetch(triangles, texel(i), 0).xyz;
  vec3 a = texelFetch(vertices, texel(2 * v.x), 0).xyz;
  vec3 ab = texelFetch(vertices, texel(2 * v.y), 0).xyz - a, ac = texelFetch(vertices, texel(2 * v.z), 0).xyz - a;
  vec3 p = cross(d, ac);
  float determinant = dot(ab, p);
  if (determinant == 0.0) return;
  float inverse_ = 1.0 / determinant;
  vec3 s = o - a, q = cross(s, ab);
  vec2 uv = vec2(dot(s, p), dot(d, q)) * inverse_;
  float t = dot(ac, q) * inverse_;
  if (uv.x >= 0.0 && uv.y >= 0.0 && uv.x + uv.y <= 1.0 && t > 0.0 && t < hit.t) hit = Hit(t, i, uv);
}

// Where a ray enters the box of a node; beyond `most` if it does not.
float enters(vec3 o, vec3 inverse_, int node, float most) {
  vec3 a = (texelFetch(boxes, texel(2 * node), 0).xyz - o) * inverse_;
  vec3 b = (texelFetch(boxes, texel(2 * node + 1), 0).xyz - o) * inverse_;
  vec3 near = min(a, b), far = max(a, b);
  float first = max(max(near.x, near.y), max(near.z, 0.0)), last = min(min(far.x, far.y), far.z);
  return first <= last * 1.0000004 && first < most ? first : 1e30;
}

Hit intersect(vec3 o, vec3 d) {
  Hit hit = Hit(1e29, -1, vec2(0));
  vec3 inverse_ = 1.0 / mix(d, vec3(1e-20), equal(d, vec3(0)));
  int first_leaf = (1 << depth) - 1, stack[26], height = 0, node = 0;
  if (enters(o, inverse_, 0, hit.t) > 1e29) return hit;
  while (true) {
    if (node >= first_leaf) {
      int i = int(texelFetch(boxes, texel(2 * node), 0).w), end = int(texelFetch(boxes, texel(2 * node + 1), 0).w);
      for (; i < end; ++i) meet(o, d, i, hit);
      node = -1;
    } else {
      int left = 2 * node + 1, right = left + 1;
      float to_left = enters(o, inverse_, left, hit.t), to_right = enters(o, inverse_, right, hit.t);
      bool left_first = to_left <= to_right;
      float nearer = min(to_left, to_right), farther = max(to_left, to_right);
      node = nearer < 1e29 ? (left_first ? left : right) : -1;
      if (farther < 1e29) stack[height++] = left_first ? right : left;
    }
    while (node < 0) {
      if (height == 0) return hit;
      node = stack[--height];
      // A nearer triangle may have been found since.
      if (enters(o, inverse_, node, hit.t) > 1e29) node = -1;
    }
  }
}

// Microfacets of Beckmann's distribution, or of that of Trowbridge and Reitz (`ggx`); Walter et al. 2007.
struct Rough { float alpha; bool ggx; };
// Normal of a microfacet; the normal itself for a smooth surface.
vec3 facet(vec3 n, Rough r) {
  if (r.alpha == 0.0) return n;
  float u = random(), tan2 = r.alpha * r.alpha * (r.ggx ? u / (1.0 - u) : -log(1.0 - u)), angle = 6.283185307 * random();
  vec3 s = normalize(abs(n.x) > 0.5 ? cross(n, vec3(0, 1, 0)) : cross(n, vec3(1, 0, 0)));
  vec2 side = sqrt(tan2) * vec2(cos(angle), sin(angle));
  return normalize(n + side.x * s + side.y * cross(n, s));
}
float hidden(float c, Rough r) {   // Smith's masking
  float tan_ = sqrt(max(1.0 - c * c, 1e-12)) / abs(c);
  if (r.ggx) return 2.0 / (1.0 + sqrt(1.0 + r.alpha * r.alpha * tan_ * tan_));
  float a = 1.0 / (r.alpha * tan_);
  return a < 1.6 ? (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a) : 1.0;
}
// Area of facets per area and solid angle; `facet` has this times dot(n, m) as its density.
float facets_towards(vec3 n, vec3 m, Rough r) {
  float c2 = dot(n, m) * dot(n, m), a2 = r.alpha * r.alpha;
  if (r.ggx) {
    float k = c2 * (a2 - 1.0) + 1.0;
    return a2 / (3.14159265 * k * k);
  }
  return exp((1.0 - 1.0 / c2) / a2) / (3.14159265 * a2 * c2 * c2);
}
// Weight of a direction `o` that a sampled facet `m` gives for the direction `i`.
float weight(vec3 n, vec3 m, vec3 i, vec3 o, Rough r) {
  if (r.alpha == 0.0) return 1.0;
  return abs(dot(i, m)) * hidden(dot(i, n), r) * hidden(dot(o, n), r) / max(abs(dot(i, n) * dot(m, n)), 1e-6);
}

float fresnel(float c, float index, out float c_t) {   // index: beyond over before
  float s2 = (1.0 - c * c) / (index * index);
  c_t = sqrt(max(1.0 - s2, 0.0));
  if (s2 >= 1.0) return 1.0;
  float s = (c - index * c_t) / (c + index * c_t), p = (index * c - c_t) / (index * c + c_t);
  return 0.5 * (s * s + p * p);
}

vec3 schlick(vec3 r, float c) { return r + (1.0 - r) * pow(1.0 - c, 5.0); }

// Mean of a value of the corners of a triangle, by barycentric coordinates, at its front (0) or back (1).
vec3 between(sampler2D values, ivec4 t, vec3 at, int back) {
  return at.x * texelFetch(values, texel(2 * t.x + back), 0).rgb + at.y * texelFetch(values, texel(2 * t.y + back), 0).rgb
    + at.z * texelFetch(values, texel(2 * t.z + back), 0).rgb;
}
vec3 pattern(ivec4 t, vec3 at) {
  float number = texelFetch(surfaces, texel(5 * t.w + 1), 0).w;
  if (number == 0.0) return vec3(1);
  vec2 place = vec2(0);
  for (int k = 0; k < 3; ++k)
    place += at[k] * vec2(texelFetch(vertices, texel(2 * t[k]), 0).w, texelFetch(vertices, texel(2 * t[k] + 1), 0).w);
  int wrap = int(texelFetch(surfaces, texel(5 * t.w), 0).y) / 32;
  vec2 border = 0.5 / vec2(textureSize(patterns, 0).xy);
  if (wrap == MIRRORED) place = 1.0 - abs(mod(place, 2.0) - 1.0);
  if (wrap != REPEATED) place = clamp(place, border, 1.0 - border);
  return textureLod(patterns, vec3(place, number - 1.0), 0.0).rgb;
}
// Radiance of a point of a triangle.
vec3 sent_out(ivec4 t, vec3 at, int back) { return between(light, t, at, back) * pattern(t, at); }
vec3 sent_out_softly(ivec4 t, vec3 at, int back, int flags) {
  // The pattern of an emitter is that of its own light.
  return between(soft_light, t, at, back) * ((flags & EMITS) != 0 ? vec3(1) : pattern(t, at));
}

// Radiance of the studio, which a ray meets that leaves the lamp.
float studio(vec3 o, vec3 d) {
  for (int k = 0; k < 16; k += 4) {
    vec3 x = softboxes[k], y = softboxes[k + 1], z = softboxes[k + 2];
    float c = dot(d, z);
    if (c >= 0.0) continue;
    vec3 at = o + dot(softboxes[k + 3] - o, z) / c * d - softboxes[k + 3];
    if (dot(at, d) >= dot(o - softboxes[k + 3], d) && abs(dot(at, x)) <= dot(x, x) && abs(dot(at, y)) <= dot(y, y)) return softbox;
  }
  return studio_backdrop;
}

float luminance(vec3 c) { return dot(c, vec3(0.2126, 0.7152, 0.0722)); }
// Mean luminance of a triangle's front: the density of sampled points per area is this over `power`.
float brightness(ivec3 t) {
  return luminance(texelFetch(light, texel(2 * t.x), 0).rgb + texelFetch(light, texel(2 * t.y), 0).rgb + texelFetch(light, texel(2 * t.z), 0).rgb) / 3.0;
}

// Share of light that crosses glass straight, by the angle outside it; 0 for other surfaces.
vec3 crossing(ivec4 t, vec4 s, vec3 d, vec3 face) {
  if (int(s.x) != GLASS && int(s.x) != THIN_GLASS) return vec3(0);
  float unused, r = fresnel(abs(dot(d, face)), s.w, unused);
  if (int(s.x) == THIN_GLASS && r < 1.0) r *= 2.0 / (1.0 + r);
  return (1.0 - r) * texelFetch(surfaces, texel(5 * t.w + 2), 0).rgb;
}
vec3 face_of(ivec4 t) {
  vec3 a = texelFetch(vertices, texel(2 * t.x), 0).xyz;
  return normalize(cross(texelFetch(vertices, texel(2 * t.y), 0).xyz - a, texelFetch(vertices, texel(2 * t.z), 0).xyz - a));
}

// Light of one sampled point of an emitter that a rough metal at `p` reflects.
vec3 sampled_light(vec3 p, vec3 i, vec3 n, vec3 face, vec3 reflected, Rough rough, vec3 absorption) {
  if (num_lights == 0) return vec3(0);
  float u = random();
  int low = 0, high = num_lights - 1;
  while (low < high) {
    int middle = (low + high) / 2;
    if (texelFetch(lights, texel(middle), 0).r < u) low = middle + 1; else high = middle;
  }
  int chosen = int(texelFetch(lights, texel(low), 0).g);
  ivec4 t = texelFetch(triangles, texel(chosen), 0);
  vec2 b = vec2(random(), random());
  if (b.x + b.y > 1.0) b = 1.0 - b;
  vec3 at = vec3(1.0 - b.x - b.y, b);
  vec3 y = at.x * texelFetch(vertices, texel(2 * t.x), 0).xyz + at.y * texelFetch(vertices, texel(2 * t.y), 0).xyz + at.z * texelFetch(vertices, texel(2 * t.z), 0).xyz;
  vec3 o = p + ABOVE * face;
  float far = distance(o, y);
  vec3 d = (y - o) / far;
  float c_o = dot(d, n), c_y = -dot(d, face_of(t));
  vec3 m = normalize(i + d);
  float c_m = dot(i, m);
  if (c_o <= 0.0 || c_y <= 0.0 || c_m <= 0.0 || dot(d, face) <= 0.0) return vec3(0);
  vec3 share = vec3(1);
  float gone = 0.0;
  for (int k = 0; k < MAX_CROSSINGS; ++k) {
    Hit hit = intersect(o, d);
    if (hit.triangle < 0 || hit.triangle == chosen || gone + hit.t > far - 2.0 * ABOVE) break;
    share *= exp(-absorption * hit.t);
    ivec4 crossed = texelFetch(triangles, texel(hit.triangle), 0);
    vec4 s = texelFetch(surfaces, texel(5 * crossed.w), 0);
    vec3 f = face_of(crossed);
    share *= crossing(crossed, s, d, f);
    if (max(share.r, max(share.g, share.b)) <= 0.0) return vec3(0);
    if ((int(s.y) & BETWEEN_MEDIA) != 0) absorption = texelFetch(surfaces, texel(5 * crossed.w + (dot(d, f) < 0.0 ? 3 : 4)), 0).rgb;
    gone += hit.t + ABOVE;
    o += (hit.t + ABOVE) * d;
  }
  float by_light = brightness(t.xyz) / power * far * far / c_y;
  float facets = facets_towards(n, m, rough), by_facets = facets * dot(n, m) / (4.0 * c_m);
  vec3 sent = sent_out(t, at, 0);
  // Balance heuristic: value / (sum of both densities).
  return share * sent * schlick(reflected, c_m) * facets * hidden(dot(i, n), rough) * hidden(c_o, rough) / (4.0 * dot(i, n)) / (by_light + by_facets);
}

// Along a ray: radiance, the share of the light behind the lamp that it shows, and radiance in the studio.
struct Seen { vec3 own, behind, soft; };
Seen follow(vec3 o, vec3 d) {
  // Of the lamp's own light the share is less by the weight of sampled emitters.
  vec3 share = vec3(1), absorption = vec3(0), sum = vec3(0), rough_at = vec3(0);
  bool bent = false;
  float by_facets = -1.0;   // density of the direction from the last vertex, if emitters were sampled there
  bool straight = false;
  for (int n = 0; n < MAX_VERTICES; ++n) {
    Hit hit = intersect(o, d);
    // Nobody sees the softboxes but in the lamp.
    if (hit.triangle < 0) return Seen(sum, straight ? vec3(0) : share, share * (bent ? studio(o, d) : studio_backdrop));
    share *= exp(-absorption * hit.t);
    ivec4 t = texelFetch(triangles, texel(hit.triangle), 0);
    vec4 s = texelFetch(surfaces, texel(5 * t.w), 0);
    int kind = int(s.x), flags = int(s.y);
    vec3 at = vec3(1.0 - hit.uv.x - hit.uv.y, hit.uv);
    vec3 a = texelFetch(vertices, texel(2 * t.x), 0).xyz, b = texelFetch(vertices, texel(2 * t.y), 0).xyz, c = texelFetch(vertices, texel(2 * t.z), 0).xyz;
    vec3 face = normalize(cross(b - a, c - a)), normal = face;
    bool front = dot(d, face) < 0.0;
    if (!front && (flags & HAS_BACK) == 0 && kind != GLASS && kind != THIN_GLASS) return Seen(sum, vec3(0), vec3(0));
    vec3 p = o + hit.t * d;
    if (kind == 0) {
      int back = front ? 0 : 1;
      vec3 own = share;
      if (front && by_facets > 0.0 && (flags & EMITS) != 0) {
        vec3 from = p - rough_at;
        own *= by_facets / (by_facets + brightness(t.xyz) / power * dot(from, from) / max(-dot(d, face), 1e-6));
      }
      return Seen(sum + own * sent_out(t, at, back), vec3(0), share * sent_out_softly(t, at, back, flags));
    }
    if ((flags & SMOOTH) != 0) normal = normalize(at.x * texelFetch(vertices, texel(2 * t.x + 1), 0).xyz
      + at.y * texelFetch(vertices, texel(2 * t.y + 1), 0).xyz + at.z * texelFetch(vertices, texel(2 * t.z + 1), 0).xyz);
    if (straight && kind != METAL) {
      share *= crossing(t, s, d, face);
      if ((flags & BETWEEN_MEDIA) != 0) absorption = texelFetch(surfaces, texel(5 * t.w + (front ? 3 : 4)), 0).rgb;
      o = p + ABOVE * d;
      continue;
    }
    bool entering = dot(d, normal) < 0.0;
    if (!entering) normal = -normal;
    Rough rough = Rough(s.z, (flags & GGX) != 0);
    vec3 m = facet(normal, rough);
    float cosine = -dot(d, m);
    if (cosine <= 0.0) return Seen(sum, vec3(0), vec3(0));
    vec3 towards = d + 2.0 * cosine * m;
    vec3 reflected = texelFetch(surfaces, texel(5 * t.w + 1), 0).rgb;
    bool crosses = false;
    by_facets = -1.0;
    if (kind == METAL) {
      if (s.z > 0.0) {
        vec3 outer = dot(d, face) < 0.0 ? face : -face;
        sum += share * sampled_light(p, -d, normal, outer, reflected, rough, absorption);
        straight = true;
        rough_at = p;
        by_facets = facets_towards(normal, m, rough) * dot(normal, m) / (4.0 * cosine);
      }
      share *= schlick(reflected, cosine);
    }
    else {
      float index = kind == THIN_GLASS || entering ? s.w : 1.0 / s.w, c_t;
      float r = fresnel(cosine, index, c_t);
      if (kind == THIN_GLASS && r < 1.0) r *= 2.0 / (1.0 + r);
      crosses = random() >= r;
      if (crosses) {
        if (kind == THIN_GLASS) towards = d;
        else {
          towards = normalize(d / index + (cosine / index - c_t) * m);
          share /= index * index;
        }
        share *= texelFetch(surfaces, texel(5 * t.w + 2), 0).rgb;
      } else share *= reflected;
    }
    share *= weight(normal, m, d, towards, rough);
    // A facet may send a ray to the wrong side of the surface.
    if (dot(towards, normal) * (crosses ? -1.0 : 1.0) <= 0.0) return Seen(sum, vec3(0), vec3(0));
    if (crosses && (flags & BETWEEN_MEDIA) != 0) absorption = texelFetch(surfaces, texel(5 * t.w + (entering ? 3 : 4)), 0).rgb;
    o = p + face * (dot(towards, face) > 0.0 ? ABOVE : -ABOVE);
    bent = bent || towards != d;
    d = towards;
    if (n >= ROULETTE_FROM) {
      float survival = min(max(share.r, max(share.g, share.b)), 0.95);
      if (random() >= survival) return Seen(sum, vec3(0), vec3(0));
      share /= survival;
    }
  }
  return Seen(sum, vec3(0), vec3(0));
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  state = uint(at.x) * 1973u + uint(at.y) * 9277u + uint(sample_) * 26699u + 1u;
  for (int i = 0; i < 3; ++i) state = (state ^ (state >> 16u)) * 2246822519u + 3266489917u;
  vec2 s = (2.0 * (vec2(at) + vec2(random(), random())) / resolution - 1.0) * half_field;
  Seen found = follow(eye, normalize(camera * vec3(s, 1)));
  radiance = vec4(found.own, dot(found.behind, vec3(1.0 / 3.0)));
  seen = vec4(found.behind, 1);
  soft = vec4(found.soft, 1);
  if (sample_ == 0) return;
  float part = 1.0 / float(sample_ + 1);
  radiance = mix(texelFetch(previous, at, 0), radiance, part);
  seen = mix(texelFetch(previous_seen, at, 0), seen, part);
  soft = mix(texelFetch(previous_soft, at, 0), soft, part);
}
