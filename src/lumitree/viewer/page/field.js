// The asset of the page.
const asset = content;
// The field: its textures, and images of it.
const field = {
  target: makeTarget(2),
  complete: false,
  maxDensity: 1,
  load(arrays) {
    const { l_max, law, density_shift } = asset.field, K = (l_max + 1) ** 2;
    this.nodes = longTexture(arrays.nodes, 1, gl.R32I, gl.RED_INTEGER, gl.INT);
    const density = new Float32Array(Uint32Array.from(arrays.density, code => code << density_shift).buffer);
    this.density = longTexture(density, 1, gl.R32F, gl.RED, gl.FLOAT);
    this.coefficients = longTexture(arrays.coefficients, 3, gl.RGB16I, gl.RGB_INTEGER, gl.SHORT);
    this.maxDensity = density.reduce((a, b) => Math.max(a, b), 1e-9);
    this.program = makeProgram("field", `#define L_MAX ${l_max}\n#define NUM_COEFFICIENTS ${K}\n${law === "linear" ? "#define LINEAR\n" : ""}`);
  },
  restart() { this.complete = false; },
  // Fills `target`; returns ms, the wait for the GPU included.
  draw({ eye, camera, fov }, width, height) {
    const begin = performance.now(), { tree_depth, level_bits, level_starts, steps, colour } = asset.field;
    bindTarget(this.target, width, height);
    const t = Math.tan(fov / 2);
    draw(this.program, {
      nodes: this.nodes, density: this.density, coefficients: this.coefficients,
      tree_depth: int(tree_depth), num_levels: int(level_bits.length),
      level_bits: int(...level_bits, 0, 0, 0).slice(0, 4), level_starts: int(...level_starts, 0, 0, 0).slice(0, 4),
      steps: steps.slice(0, 4), brightness: steps.slice(4),
      half_extents: asset.half_extents, colour, eye, camera, half_field: [t * width / height, t], resolution: [width, height],
    });
    this.complete = true;
    readTarget(this.target, 0, 1, 1);
    return performance.now() - begin;
  },
};

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const normalised = v => { const n = Math.hypot(...v); return v.map(x => x / n); };
function lookAt(eye, target, up) {
  const forward = normalised(target.map((x, i) => x - eye[i]));
  const right = normalised(cross(forward, up));
  return [...right, ...cross(right, forward), ...forward];
}
