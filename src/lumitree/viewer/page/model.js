// Bit of a surface's flags; most triangles of a leaf.
const EMITS = 8, LEAF_SIZE = 4;
// Quickselect: what is before `middle` in the order is not above what is after it, along an axis.
function divide(order, middles, axis, first, middle, last) {
  const at = i => middles[3 * order[i] + axis];
  while (first < last) {
    const pivot = at((first + last) >> 1);
    let i = first, j = last;
    while (i <= j) {
      while (at(i) < pivot) ++i;
      while (at(j) > pivot) --j;
      if (i <= j) {
        [order[i], order[j]] = [order[j], order[i]];
        ++i;
        --j;
      }
    }
    if (middle <= j) last = j;
    else if (middle >= i) first = i;
    else return;
  }
}

// The geometry: its textures, and images of it, which become less noisy as long as the view stays.
const model = {
  // Radiance; what is seen behind; and radiance in the studio.
  targets: [makeTarget(3), makeTarget(3)],
  samples: 0,
  maxSamples: 1024,
  async load(arrays) {
    const { triangles: count, surfaces, codes } = asset.model;
    const [positionCodes, normalCodes, codesAStop, zero, placeCodes] = codes;
    const place = (code, count) => 2 * code / (count - 1) - 1;
    const vertices = arrays.positions.length / 3, points = new Float32Array(8 * vertices);
    for (let i = 0; i < vertices; ++i) {
      for (let k = 0; k < 3; ++k) points[8 * i + k] = place(arrays.positions[3 * i + k], positionCodes);
      const [x, y] = [0, 1].map(k => place(arrays.normals[2 * i + k], normalCodes)), z = 1 - Math.abs(x) - Math.abs(y);
      // The lower half of the octahedron is folded out.
      const fold = Math.max(-z, 0), n = [x - (x < 0 ? -fold : fold), y - (y < 0 ? -fold : fold), z], length = Math.hypot(...n);
      for (let k = 0; k < 3; ++k) points[8 * i + 4 + k] = n[k] / length;
      for (let k = 0; k < 2; ++k) points[8 * i + 3 + 4 * k] = arrays.places[2 * i + k] / placeCodes;
    }
    const triangles = new Int32Array(4 * count), order = this.order(arrays.triangles, points);
    for (let i = 0; i < count; ++i) {
      for (let k = 0; k < 3; ++k) triangles[4 * i + k] = arrays.triangles[3 * order[i] + k];
      triangles[4 * i + 3] = arrays.surfaces[order[i]];
    }
    const relative = code => code > 0 ? 2 ** ((code - zero) / codesAStop) : 0;
    const radiance = (codes, scale) => {
      const values = new Float32Array(8 * vertices);
      for (let i = 0; i < 2 * vertices; ++i) {
        const [r, g, b] = codes.subarray(3 * i, 3 * i + 3);
        values.set([r + g, g, b + g].map(code => scale * relative(code)), 4 * i);
      }
      return values;
    };
    const light = radiance(arrays.light, 1), soft = radiance(arrays.soft, asset.model.max_soft);
    this.textures = {
      triangles: longTexture(triangles, 4, gl.RGBA32I, gl.RGBA_INTEGER, gl.INT),
      vertices: longTexture(points, 4, gl.RGBA32F, gl.RGBA, gl.FLOAT),
      light: longTexture(light, 4, gl.RGBA32F, gl.RGBA, gl.FLOAT),
      soft_light: longTexture(soft, 4, gl.RGBA32F, gl.RGBA, gl.FLOAT),
      boxes: longTexture(this.boxes(triangles, points), 4, gl.RGBA32F, gl.RGBA, gl.FLOAT),
      lights: longTexture(this.lights(triangles, points, light), 2, gl.RG32F, gl.RG, gl.FLOAT),
      surfaces: longTexture(new Float32Array(surfaces), 4, gl.RGBA32F, gl.RGBA, gl.FLOAT),
    };
    this.patterns = await this.images();
    this.program = makeProgram("model");
  },
  // The images of patterns, as layers of a texture.
  async images() {
    const { patterns, pattern_side: side } = asset.model, kind = gl.TEXTURE_2D_ARRAY, texture = gl.createTexture();
    gl.bindTexture(kind, texture);
    gl.texStorage3D(kind, 1, gl.SRGB8_ALPHA8, side, side, Math.max(1, patterns.length));
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, name, gl.LINEAR);
    for (const [layer, file] of patterns.entries()) {
      const bytes = Uint8Array.from(atob(file), c => c.charCodeAt(0));
      const image = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }), { colorSpaceConversion: "none" });
      gl.bindTexture(kind, texture);
      gl.texSubImage3D(kind, 0, 0, 0, layer, side, side, 1, gl.RGBA, gl.UNSIGNED_BYTE, image);
    }
    return texture;
  },
  // Triangles that emit, and the sum of their power, luminance times area, up to each.
  lights(triangles, points, light) {
    const found = [], corner = (i, k) => 8 * triangles[4 * i + k];
    let power = 0;
    for (let i = 0; i < triangles.length / 4; ++i) {
      if (!(asset.model.surfaces[20 * triangles[4 * i + 3] + 1] & EMITS)) continue;
      const [a, b, c] = [0, 1, 2].map(k => points.subarray(corner(i, k), corner(i, k) + 3));
      const area = Math.hypot(...cross(b.map((x, k) => x - a[k]), c.map((x, k) => x - a[k]))) / 2;
      let luminance = 0;
      for (let k = 0; k < 3; ++k) for (let j = 0; j < 3; ++j) luminance += [0.2126, 0.7152, 0.0722][j] * light[corner(i, k) + j] / 3;
      if (luminance * area > 0) found.push(power += luminance * area, i);
    }
    Object.assign(this, { power, numLights: found.length / 2 });
    return new Float32Array(found.length ? found.map((x, i) => i & 1 ? x : x / power) : 2);
  },
  // Order of the triangles in which a complete binary tree over equal parts of them has small boxes: a
  // node of level l has those from floor(i count / 2^l) on, and is divided along its longest side.
  order(triangles, points) {
    const { triangles: count } = asset.model, order = Uint32Array.from({ length: count }, (_, i) => i);
    const middles = new Float32Array(3 * count);
    for (let i = 0; i < count; ++i)
      for (let corner = 0; corner < 3; ++corner)
        for (let k = 0, at = 8 * triangles[3 * i + corner]; k < 3; ++k) middles[3 * i + k] += points[at + k] / 3;
    this.depth = Math.max(0, Math.ceil(Math.log2(count / LEAF_SIZE)));
    for (let level = 0; level < this.depth; ++level)
      for (let node = 0; node < 2 ** level; ++node) {
        const [start, middle, end] = [2 * node, 2 * node + 1, 2 * node + 2].map(i => Math.floor(i * count / 2 ** (level + 1)));
        const sides = [0, 1, 2].map(k => {
          let least = Infinity, most = -Infinity;
          for (let i = start; i < end; ++i) {
            const x = middles[3 * order[i] + k];
            least = Math.min(least, x);
            most = Math.max(most, x);
          }
          return most - least;
        });
        divide(order, middles, sides.indexOf(Math.max(...sides)), start, middle, end - 1);
      }
    return order;
  },
  // Boxes of this tree, leaves last.
  boxes(triangles, points) {
    const { triangles: count } = asset.model, leaves = 2 ** this.depth, boxes = new Float32Array(8 * (2 * leaves - 1));
    for (let node = 2 * leaves - 2; node >= 0; --node) {
      const lower = boxes.subarray(8 * node, 8 * node + 4), upper = boxes.subarray(8 * node + 4, 8 * node + 8);
      lower.fill(Infinity);
      upper.fill(-Infinity);
      const leaf = node - leaves + 1;
      if (leaf >= 0) {
        const first = Math.floor(leaf * count / leaves), end = Math.floor((leaf + 1) * count / leaves);
        for (let i = first; i < end; ++i)
          for (let corner = 0; corner < 3; ++corner)
            for (let k = 0, at = 8 * triangles[4 * i + corner]; k < 3; ++k) {
              lower[k] = Math.min(lower[k], points[at + k]);
              upper[k] = Math.max(upper[k], points[at + k]);
            }
        lower[3] = first;
        upper[3] = end;
      } else
        for (const child of [2 * node + 1, 2 * node + 2])
          for (let k = 0; k < 3; ++k) {
            lower[k] = Math.min(lower[k], boxes[8 * child + k]);
            upper[k] = Math.max(upper[k], boxes[8 * child + 4 + k]);
          }
    }
    return boxes;
  },
  get target() { return this.targets[this.samples & 1]; },
  restart() { this.samples = 0; },
  get complete() { return this.samples >= this.maxSamples; },
  // Adds a sample to `target`; returns ms, the wait for the GPU included.
  draw({ eye, camera, fov }, width, height) {
    const begin = performance.now(), t = Math.tan(fov / 2), { softbox, softboxes, backdrop } = asset.studio;
    const [previous, previous_seen, previous_soft] = this.target.textures;
    bindTarget(this.targets[~this.samples & 1], width, height);
    draw(this.program, {
      ...this.textures, patterns: layers(this.patterns), previous, previous_seen, previous_soft,
      softbox, studio_backdrop: backdrop, softboxes: vectors(softboxes.flat()), depth: int(this.depth), num_lights: int(this.numLights), power: this.power, sample_: int(this.samples),
      eye, camera, half_field: [t * width / height, t], resolution: [width, height],
    });
    this.samples += 1;
    readTarget(this.target, 0, 1, 1);
    return performance.now() - begin;
  },
};
