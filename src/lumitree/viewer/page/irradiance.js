// Illuminance of the walls of a box around the lamp, from the light field.
const PATCHES = 64;
const walls = {
  target: makeTarget(1),
  ready: false,
  load(arrays) {
    this.arrays = arrays;
  },
  // On first use: most of the memory of a page is here.
  prepare() {
    if (this.ready) return;
    const { cells, lit, cell_scale: scale, intensity } = this.arrays;
    const { depth, resolution } = asset.light_field, bins = resolution ** 2, count = scale.length;
    const side = 2 / 2 ** depth, boxes = new Float32Array(8 * count);
    for (let i = 0; i < count; ++i) {
      for (let k = 0; k < 3; ++k) {
        const lower = cells[3 * i + k] * side - 1, half = asset.half_extents[k];
        boxes[8 * i + k] = Math.min(Math.max(lower, -half), half);
        boxes[8 * i + 4 + k] = Math.max(Math.min(lower + side, half), -half);
      }
      boxes[8 * i + 3] = scale[i];
    }
    const dense = new Float32Array(count * bins);
    let next = 0;
    for (let b = 0; b < dense.length; ++b)
      if (lit[b >> 3] >> 7 - (b & 7) & 1) dense[b] = halfToFloat(intensity[next++]);
    this.cells = longTexture(boxes, 4, gl.RGBA32F, gl.RGBA, gl.FLOAT);
    this.intensity = longTexture(dense, 1, gl.R32F, gl.RED, gl.FLOAT);
    this.count = count;
    this.program = makeProgram("irradiance");
    this.arrays = null;
    this.ready = true;
  },
  // Illuminance in lx: Float32Array [patches][6 * patches][4], in the first channel.
  draw(room, samples, patches = PATCHES) {
    this.prepare();
    bindTarget(this.target, 6 * patches, patches);
    draw(this.program, {
      cells: this.cells, intensity: this.intensity, num_cells: int(this.count),
      bins: int(asset.light_field.resolution), samples: int(samples), patches: int(patches), room,
    });
    return readTarget(this.target);
  },
};
