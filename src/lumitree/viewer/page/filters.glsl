// Filters of images: emitters joined to the other light, half the size, and a Gaussian along an axis.
uniform sampler2D image, clamped;
uniform float most, deviation;   // largest value; standard deviation, pixels
uniform vec2 axis;
out vec4 pixel;

// Beyond its edges an image is mirrored.
vec3 at(sampler2D source, ivec2 p) {
  ivec2 size = textureSize(source, 0);
  p = ivec2(p.x < 0 ? -1 - p.x : p.x, p.y < 0 ? -1 - p.y : p.y);
  p = ivec2(p.x < size.x ? p.x : 2 * size.x - 1 - p.x, p.y < size.y ? p.y : 2 * size.y - 1 - p.y);
  return texelFetch(source, clamp(p, ivec2(0), size - 1), 0).rgb;
}

void main() {
  ivec2 p = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0);
#if defined JOIN
  float whole = 0.0;
  for (int i = 0; i < 9; ++i) {
    ivec2 d = ivec2(i % 3, i / 3) - 1;
    float weight = exp(-0.5 * float(d.x * d.x + d.y * d.y) / (deviation * deviation));
    whole += weight;
    sum += weight * at(clamped, p + d);
  }
  sum = at(image, p) + sum / whole;
  sum *= most / max(max(sum.r, max(sum.g, sum.b)), most);
#elif defined HALVE
  for (int i = 0; i < 4; ++i) sum += 0.25 * at(image, 2 * p + ivec2(i % 2, i / 2));
#else
  float whole = 0.0;
  int radius = int(ceil(3.5 * deviation));
  for (int i = -radius; i <= radius; ++i) {
    float weight = exp(-0.5 * float(i * i) / (deviation * deviation));
    whole += weight;
    sum += weight * at(image, p + i * ivec2(axis));
  }
  sum /= whole;
#endif
  pixel = vec4(sum, 1);
}
