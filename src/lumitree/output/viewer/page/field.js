// The field: its textures, and images of it.
const field = {
  target: makeTarget(2),
  load(arrays) {
    const K = (asset.l_max + 1) ** 2;
    this.nodes = longTexture(arrays.nodes, 1, gl.R32I, gl.RED_INTEGER, gl.INT);
    const density = new Float32Array(Uint32Array.from(arrays.density, code => code << asset.density_shift).buffer);
    this.density = longTexture(density, 1, gl.R32F, gl.RED, gl.FLOAT);
    this.coefficients = longTexture(arrays.coefficients, 3, gl.RGB16I, gl.RGB_INTEGER, gl.SHORT);
    this.maxDensity = density.reduce((a, b) => Math.max(a, b), 1e-9);
    const law = asset.law === "linear" ? "#define LINEAR\n" : "";
    this.program = makeProgram("field", `#define L_MAX ${asset.l_max}\n#define NUM_COEFFICIENTS ${K}\n${law}`);
  },
  // Fills `target`; returns ms, the wait for the GPU included.
  draw({ eye, camera, fov }, width, height, target = this.target) {
    const begin = performance.now();
    bindTarget(target, width, height);
    const t = Math.tan(fov / 2);
    draw(this.program, {
      nodes: this.nodes, density: this.density, coefficients: this.coefficients,
      tree_depth: int(asset.tree_depth), num_levels: int(asset.level_bits.length),
      level_bits: int(...asset.level_bits, 0, 0, 0).slice(0, 4), level_starts: int(...asset.level_starts, 0, 0, 0).slice(0, 4),
      steps: asset.steps.slice(0, 4), brightness: asset.steps.slice(4),
      half_extents: asset.half_extents, colour: asset.colour, eye, camera, half_field: [t * width / height, t], resolution: [width, height],
    });
    readTarget(target, 0, 1, 1);
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
