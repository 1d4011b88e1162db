// Radiance and transmittance of the field along the ray of each pixel (Eq. 3 and 4).
// The traversal is that of lumitree.octree.traversal: cells are integer coordinates of the last
// level, and every step crosses a plane, so that it ends.
uniform isampler2D nodes, coefficients;
uniform sampler2D density;
uniform vec4 steps;        // of the coefficients of band 0; of the others, by brightness
uniform vec2 brightness;   // from which a leaf is bright, and medium
uniform int tree_depth, num_levels;
uniform int level_bits[4], level_starts[4];
uniform vec3 half_extents, eye, colour;
uniform mat3 camera;       // columns: right, up, forward
uniform vec2 half_field;   // tangents of half the field of view
uniform vec2 resolution;
layout(location = 0) out vec4 radiance;   // radiance / L_max; transmittance
layout(location = 1) out vec4 details;    // mean density, level of the first leaf, leaves, cells

const int LEAF = 1 << 30;
ivec2 texel(int i) { return ivec2(i & 4095, i >> 12); }

void basis(vec3 v, out float y[NUM_COEFFICIENTS]) {
  float x_ = v.x, y_ = v.y, z_ = v.z;
  y[0] = 0.28209479177387814;
#if L_MAX >= 1
  y[1] = 0.4886025119029199 * y_; y[2] = 0.4886025119029199 * z_; y[3] = 0.4886025119029199 * x_;
#endif
  float xx = x_ * x_, yy = y_ * y_, zz = z_ * z_;
#if L_MAX >= 2
  y[4] = 1.0925484305920792 * x_ * y_;
  y[5] = 1.0925484305920792 * y_ * z_;
  y[6] = 0.31539156525252005 * (3.0 * zz - 1.0);
  y[7] = 1.0925484305920792 * x_ * z_;
  y[8] = 0.5462742152960396 * (xx - yy);
#endif
#if L_MAX >= 3
  y[9] = 0.5900435899266435 * y_ * (3.0 * xx - yy);
  y[10] = 2.890611442640554 * x_ * y_ * z_;
  y[11] = 0.4570457994644658 * y_ * (5.0 * zz - 1.0);
  y[12] = 0.37317633259011546 * z_ * (5.0 * zz - 3.0);
  y[13] = 0.4570457994644658 * x_ * (5.0 * zz - 1.0);
  y[14] = 1.445305721320277 * z_ * (xx - yy);
  y[15] = 0.5900435899266435 * x_ * (xx - 3.0 * yy);
#endif
#if L_MAX >= 4
  y[16] = 2.5033429417967046 * x_ * y_ * (xx - yy);
  y[17] = 1.7701307697799304 * y_ * z_ * (3.0 * xx - yy);
  y[18] = 0.9461746957575601 * x_ * y_ * (7.0 * zz - 1.0);
  y[19] = 0.6690465435572892 * y_ * z_ * (7.0 * zz - 3.0);
  y[20] = 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0);
  y[21] = 0.6690465435572892 * x_ * z_ * (7.0 * zz - 3.0);
  y[22] = 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0);
  y[23] = 1.7701307697799304 * x_ * z_ * (xx - 3.0 * yy);
  y[24] = 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
#endif
}

vec3 emission(int leaf, float y[NUM_COEFFICIENTS]) {
  vec3 logit = vec3(0);
  float step_ = steps.x;
  for (int k = 0; k < NUM_COEFFICIENTS; ++k) {
    ivec3 code = texelFetch(coefficients, texel(leaf * NUM_COEFFICIENTS + k), 0).rgb;
    logit += y[k] * step_ * vec3(code.r + code.g, code.g, code.b + code.g);
    if (k == 0) {
      float largest = float(code.g + max(max(code.r, code.b), 0)) * steps.x;
      step_ = largest >= brightness.x ? steps.y : largest >= brightness.y ? steps.z : steps.w;
    }
  }
  return colour / (1.0 + exp(-clamp(logit, -80.0, 80.0)));
}

float transmittance(float tau) {
#ifdef LINEAR
  return max(1.0 - tau, 0.0);
#else
  return exp(-tau);
#endif
}

void main() {
  radiance = vec4(0, 0, 0, 1);
  details = vec4(0);
  vec2 s = (2.0 * gl_FragCoord.xy / resolution - 1.0) * half_field;
  vec3 d = normalize(camera * vec3(s, 1));
  float y[NUM_COEFFICIENTS];
  basis(-d, y);   // towards the viewer
  d = mix(d, vec3(1e-9), lessThan(abs(d), vec3(1e-9)));
  vec3 a = (-half_extents - eye) / d, b = (half_extents - eye) / d;
  vec3 near = min(a, b), far = max(a, b);
  float start = max(max(near.x, max(near.y, near.z)), 0.0);
  float length_ = min(far.x, min(far.y, far.z)) - start;
  if (length_ <= 0.0) return;

  int side = 1 << tree_depth;
  vec3 p = (eye + start * d + 1.0) * (0.5 * float(side)), step_ = d * (0.5 * float(side));
  bvec3 rises = greaterThan(d, vec3(0));
  ivec3 up = ivec3(rises);
  int octant = up.x + 2 * up.y + 4 * up.z;
  ivec3 cell = clamp(ivec3(floor(p)), ivec3(0), ivec3(side - 1));
  float t = 0.0, tau = 0.0, before = 1.0, inside = 0.0, first = 0.0;
  int leaves = 0, cells = 0;
  for (; cells < 8192; ++cells) {
    int below = tree_depth, node = 0, entry = 0;
    for (int l = 0; l < num_levels; ++l) {
      int bits = level_bits[l];
      below -= bits;
      ivec3 c = (cell >> below) & ((1 << bits) - 1);
      entry = texelFetch(nodes, texel(level_starts[l] + (node << 3 * bits)
        + (c.z << 2 * bits) + (c.y << bits) + c.x), 0).r;
      if (entry < 0 || (entry & LEAF) != 0) break;
      node = entry;
    }
    ivec3 lower, upper;
    int leaf = -1, log_side = 0;
    if (entry < 0) {
      int n = (entry >> (3 * octant) & 7) + 1;
      ivec3 c = cell >> below;
      lower = (c - (1 - up) * (n - 1)) << below;
      upper = (c + 1 + up * (n - 1)) << below;
    } else {
      leaf = (entry & (LEAF - 1)) >> 4;
      log_side = entry & 15;
      lower = (cell >> log_side) << log_side;
      upper = lower + (1 << log_side);
    }
    vec3 planes = (mix(vec3(lower), vec3(upper), rises) - p) / step_;
    int axis = planes.x < planes.y ? (planes.x < planes.z ? 0 : 2) : (planes.y < planes.z ? 1 : 2);
    float next = clamp(planes[axis], t, length_);
    if (leaf >= 0 && next > t) {
      float sigma = texelFetch(density, texel(leaf), 0).r;
      tau += sigma * (next - t);
      inside += next - t;
      if (leaves == 0) first = float(tree_depth - log_side);
      leaves += 1;
      float after = transmittance(tau);
      if (before > after) radiance.rgb += (before - after) * emission(leaf, y);
      before = after;
      if (after < 1e-6) break;
    }
    t = next;
    if (t >= length_) break;
    ivec3 reached = clamp(ivec3(floor(p + t * step_)), lower, upper - 1);
    reached[axis] = rises[axis] ? upper[axis] : lower[axis] - 1;
    if (reached[axis] < 0 || reached[axis] >= side) break;
    cell = reached;
  }
  radiance.a = before;
  details = vec4(inside > 0.0 ? tau / inside : 0.0, first, float(leaves), float(cells + 1));
}
