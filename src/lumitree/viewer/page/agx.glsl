// Before shaders that show colours; AgX as in lumitree.rendering.view_transform, which has the constants.
vec3 encode(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

vec3 agx(vec3 c) {
  c = BEFORE * clamp(c, -MOST, MOST);
  vec3 offset = clamp((log2(max(c, 1e-10) / GREY) - LOW) / (HIGH - LOW), 0.0, 1.0) - MIDDLE;
  vec3 above = step(0.0, offset), power = mix(vec3(TOE), vec3(SHOULDER), above), reach = mix(vec3(MIDDLE), vec3(1.0 - MIDDLE), above);
  vec3 bend = (pow(2.0 * SLOPE * reach, power) - 1.0) * pow(abs(offset) / reach, power);
  vec3 curved = clamp(0.5 + SLOPE * offset * pow(1.0 + bend, -1.0 / power), 0.0, 1.0);
  return clamp(AFTER * pow(max(SATURATED * pow(curved, vec3(LOOK_POWER)), 0.0), vec3(GAMMA)), 0.0, 1.0);
}
