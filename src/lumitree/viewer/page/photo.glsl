// The photograph: bloom, white balance and view transform, as lumitree.rendering.photograph.
uniform sampler2D image, bloom0, bloom1, bloom2;
uniform vec2 scale0, scale1, scale2;   // places on the images of bloom for a pixel
uniform vec3 weights;
uniform float share;
uniform mat3 adaptation;
uniform int clip;                      // view "srgb"
out vec4 pixel;

void main() {
  // The first row of an image is the upper one.
  vec2 place = vec2(gl_FragCoord.x, float(textureSize(image, 0).y) - gl_FragCoord.y);
  vec3 scattered = weights.x * texture(bloom0, place * scale0).rgb + weights.y * texture(bloom1, place * scale1).rgb + weights.z * texture(bloom2, place * scale2).rgb;
  vec3 c = mix(texelFetch(image, ivec2(place), 0).rgb, scattered, share);
  c = adaptation * c;
  pixel = vec4(encode(clip != 0 ? c : agx(c)), 1);
}
