"use strict";
// Draws with WebGL 2 what the page asks for; knows nothing of the page.
const SHAPES = ["plane", "sphere", "torus", "cloth"];
const QUERIES = 4;
const MESHES = [2, 3];
const VIEWS = { material: 0, levels: 1, answer: 2, error: 3 };
const MOST_LIGHTS = 8;
// Squares of a mesh, seen and as what casts shadows.
const GRID = [240, 160];
const SHADOW_GRID = [120, 80];
// Vectors in a row of the texture of weights, as the material's shader reads it.
const WEIGHTS_WIDTH = 1024;

// Vectors.
const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const scaled = (a, s) => a.map((v) => v * s);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));

// A camera's axes; right and up reach to the edges of the picture at depth 1. `fov` is horizontal, in degrees.
function axes({ origin, target, up, fov }, width, height) {
  const forward = unit(add(target, origin, -1));
  const right = unit(cross(forward, up));
  const half = Math.tan((fov * Math.PI) / 360);
  return {
    eye: origin,
    forward,
    right: scaled(right, half),
    up: scaled(cross(right, forward), (half * height) / width),
    pitch: (2 * half) / width,
  };
}

// Column-major matrices that put the picture on [-1, 1]^2.
function perspective({ eye, forward, right, up }, shift) {
  const [near, far] = [0.02, 60];
  const rows = [scaled(right, 1 / dot(right, right)), scaled(up, 1 / dot(up, up))];
  const z = scaled(forward, (far + near) / (far - near));
  const all = [add(rows[0], forward, shift[0]), add(rows[1], forward, shift[1]), z, forward];
  const last = all.map((row) => -dot(row, eye));
  last[2] -= (2 * far * near) / (far - near);
  return new Float32Array([0, 1, 2].flatMap((c) => all.map((row) => row[c])).concat(last));
}
function parallel(direction, radius) {
  const side = unit(cross(Math.abs(direction[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1], direction));
  const all = [side, cross(direction, side), scaled(direction, -1)].map((row) => scaled(row, 1 / radius));
  const columns = [0, 1, 2].flatMap((c) => all.map((row) => row[c]).concat(0));
  return new Float32Array(columns.concat(0, 0, 0, 1));
}

// The numbers of the page: 32-bit floats, or 16-bit ones that are widened.
function unpacked(text) {
  const binary = atob(text.trim());
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes.buffer;
}
let widened = null;
function floats(buffer, { at, count, half }) {
  if (!half) return new Float32Array(buffer, at, count);
  widened ??= Float32Array.from({ length: 1 << 16 }, (_, h) => {
    const [sign, exponent, rest] = [h >> 15 ? -1 : 1, (h >> 10) & 31, h & 1023];
    return sign * (exponent ? 2 ** (exponent - 15) * (1 + rest / 1024) : 2 ** -24 * rest);
  });
  return new Float32Array(new Uint16Array(buffer, at, count)).map((h) => widened[h]);
}

class Engine {
  constructor(canvas, data, numbers) {
    Object.assign(this, { canvas, data, numbers });
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    this.gl = canvas.getContext("webgl2", { ...options, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("This page needs WebGL 2, which this browser does not offer here.");
    this.restore();
  }

  // Everything that lives in the context; again after it was lost.
  restore() {
    const { gl, data } = this;
    if (!gl.getExtension("EXT_color_buffer_float")) {
      throw new Error("This page needs to draw to float textures (EXT_color_buffer_float), which this browser cannot.");
    }
    this.smooth = gl.getExtension("OES_texture_float_linear") !== null;
    this.parallel = gl.getExtension("KHR_parallel_shader_compile");
    this.most = gl.getParameter(gl.MAX_UNIFORM_BLOCK_SIZE);
    const finest = Object.values(data.numbers.textures).map((levels) => levels[0]);
    const side = Math.max(...finest.flatMap(({ height, width }) => [height, width]));
    if (side > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new Error(`The material's ${side} texels are more than a texture of this device can have.`);
    }
    this.programs = new Map();
    this.targets = new Map();
    this.meshes = new Map();
    this.empty = gl.createVertexArray();
    const { blend_frag, present_frag, depth_frag, scene_vert } = data.glsl;
    this.blending = this.link(QUERIES, scene_vert, blend_frag);
    this.presenting = this.link(QUERIES, scene_vert, present_frag);
    this.filling = MESHES.map((shape) => this.link(shape, scene_vert, depth_frag));
    const weights = floats(this.numbers, data.numbers.weights);
    this.weights = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.weights);
    gl.bufferData(gl.UNIFORM_BUFFER, weights, gl.STATIC_DRAW);
    // Weights beyond a uniform block are a texture.
    const rows = Math.ceil(weights.length / (4 * WEIGHTS_WIDTH));
    const padded = new Float32Array(4 * WEIGHTS_WIDTH * rows);
    padded.set(weights);
    this.weightsTexture = this.values(WEIGHTS_WIDTH, rows, padded);
    this.textures = { exact: this.upload(false), fast: this.upload(true) };
    this.shadows = this.depths(1024);
    this.queries = null;
  }

  // Texture arrays of four channels a layer, a mip a level: 32-bit and unfiltered, or 16-bit and filtered.
  upload(fast) {
    const { gl, data } = this;
    const made = {};
    for (const [name, levels] of Object.entries(data.numbers.textures)) {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
      const layers = levels[0].layers;
      const format = fast ? gl.RGBA16F : gl.RGBA32F;
      gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levels.length, format, levels[0].width, levels[0].height, layers);
      levels.forEach((level, k) => {
        const { width, height } = level;
        const values = floats(this.numbers, level);
        gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, k, 0, 0, 0, width, height, layers, gl.RGBA, gl.FLOAT, values);
      });
      const [min, mag] = fast ? [gl.LINEAR_MIPMAP_LINEAR, gl.LINEAR] : [gl.NEAREST_MIPMAP_NEAREST, gl.NEAREST];
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, min);
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, mag);
      made[name] = texture;
    }
    return made;
  }

  // A program that may still be in the making: see `ready`.
  link(shape, vertex, fragment, material = "") {
    const { gl } = this;
    const head = `#version 300 es\n#define SHAPE ${shape}\n` + "precision highp float;\nprecision highp int;\nprecision highp sampler2DArray;\n";
    const program = gl.createProgram();
    const { surface } = this.data.glsl;
    for (const [kind, text] of [[gl.VERTEX_SHADER, surface + vertex], [gl.FRAGMENT_SHADER, material + surface + fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, head + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    const cache = new Map();
    const at = (name) => {
      if (!cache.has(name)) cache.set(name, gl.getUniformLocation(program, name));
      return cache.get(name);
    };
    return { program, at, checked: false };
  }

  // The program of a mode, a shape and a view, or null while it is made; with `wait` it is there.
  ready(mode, shape, view, wait) {
    const { gl, data } = this;
    const key = `${mode} ${shape} ${view}`;
    if (!this.programs.has(key)) {
      const { scene_vert, scene_frag } = data.glsl;
      const material = `#define VIEW ${view}\n` + data.shader.modes[mode];
      this.programs.set(key, this.link(shape, scene_vert, scene_frag, material));
    }
    const made = this.programs.get(key);
    if (made.checked) return made;
    if (!wait && this.parallel && !gl.getProgramParameter(made.program, this.parallel.COMPLETION_STATUS_KHR)) return null;
    this.check(made);
    const block = gl.getUniformBlockIndex(made.program, "NeumipWeights");
    if (block !== gl.INVALID_INDEX) gl.uniformBlockBinding(made.program, block, 0);
    return made;
  }
  check(made) {
    const { gl } = this;
    if (!made.checked && !gl.getProgramParameter(made.program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(made.program).map((s) => gl.getShaderInfoLog(s));
      const bytes = 4 * this.data.numbers.weights.count;
      if (bytes > this.most) logs.unshift(`its weights take ${bytes} bytes, a uniform block here ${this.most};`);
      throw new Error(`The shader does not compile here: ${logs.concat(gl.getProgramInfoLog(made.program)).join(" ").trim()}`);
    }
    made.checked = true;
  }
  use(made) {
    this.check(made);
    this.gl.useProgram(made.program);
    return made.at;
  }

  // A texture to draw to, kept by name while its size stays.
  target(name, width, height, { depth = false, linear = false } = {}) {
    const { gl } = this;
    const old = this.targets.get(name);
    if (old && old.width === width && old.height === height) return old;
    if (old) {
      gl.deleteFramebuffer(old.frame);
      gl.deleteTexture(old.texture);
      if (old.depth) gl.deleteRenderbuffer(old.depth);
    }
    const made = { width, height, texture: gl.createTexture(), frame: gl.createFramebuffer(), depth: null };
    gl.bindTexture(gl.TEXTURE_2D, made.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, linear && !this.smooth ? gl.RGBA16F : gl.RGBA32F, width, height);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, side, linear ? gl.LINEAR : gl.NEAREST);
    }
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.texture, 0);
    if (depth) {
      made.depth = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, made.depth);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, made.depth);
    }
    this.targets.set(name, made);
    return made;
  }
  depths(side) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.DEPTH_COMPONENT24, side, side, MOST_LIGHTS);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, filter, gl.LINEAR);
    }
    return { texture, frame: gl.createFramebuffer(), side, key: "" };
  }

  // Points of a grid over [0, 1]^2 and its triangles.
  mesh(columns, rows) {
    const { gl } = this;
    const key = `${columns} ${rows}`;
    if (this.meshes.has(key)) return this.meshes.get(key);
    const points = new Float32Array(2 * (columns + 1) * (rows + 1));
    const corners = new Uint32Array(6 * columns * rows);
    for (let j = 0, at = 0, corner = 0; j <= rows; j++) {
      for (let i = 0; i <= columns; i++, at++) {
        points.set([i / columns, j / rows], 2 * at);
        if (i < columns && j < rows) {
          corners.set([at, at + 1, at + columns + 1, at + columns + 1, at + 1, at + columns + 2], corner);
          corner += 6;
        }
      }
    }
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    this.meshes.set(key, { array, count: corners.length });
    return this.meshes.get(key);
  }
  drawMesh(columns, rows) {
    const { gl } = this;
    const mesh = this.mesh(columns, rows);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }
  drawAll() {
    this.gl.bindVertexArray(this.empty);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }
  bind(slot, kind, texture, location) {
    this.gl.activeTexture(this.gl.TEXTURE0 + slot);
    this.gl.bindTexture(kind, texture);
    this.gl.uniform1i(location, slot);
  }

  // What the lights see: drawn again only when they or the shape move.
  shade(shape, lights, matrices) {
    const { gl, shadows } = this;
    const key = JSON.stringify([shape, lights.map((l) => l.direction)]);
    if (shadows.key === key) return;
    shadows.key = key;
    const at = this.use(this.filling[MESHES.indexOf(shape)]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.viewport(0, 0, shadows.side, shadows.side);
    gl.bindFramebuffer(gl.FRAMEBUFFER, shadows.frame);
    lights.forEach((_, k) => {
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, shadows.texture, 0, k);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix4fv(at("projection"), false, matrices[k]);
      this.drawMesh(...SHADOW_GRID);
    });
    gl.disable(gl.DEPTH_TEST);
  }

  // Draws a scene, or the answers to queries, into a target; false while the program is made.
  draw(target, scene, wait = false) {
    const { gl, data } = this;
    const { width, height } = target;
    const shape = scene.queries ? QUERIES : SHAPES.indexOf(scene.shape);
    const made = this.ready(scene.mode, shape, scene.view ?? VIEWS.material, wait);
    if (!made) return false;
    const mesh = MESHES.includes(shape);
    const lights = scene.queries ? [{ direction: [0, 0, 1], irradiance: [1, 1, 1] }] : scene.lights;
    const matrices = lights.map((l) => parallel(l.direction, 1.35));
    const shaded = mesh && scene.view !== VIEWS.levels;
    if (shaded) this.shade(shape, lights, matrices);
    const camera = scene.queries ? null : axes(scene.camera, width, height);
    const jitter = scene.jitter ?? [0, 0];
    const projection = mesh ? perspective(camera, [(-2 * jitter[0]) / width, (-2 * jitter[1]) / height]) : null;

    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (mesh) {
      // Depth first: every pixel asks the material once.
      const at = this.use(this.filling[MESHES.indexOf(shape)]);
      gl.uniformMatrix4fv(at("projection"), false, projection);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LESS);
      gl.colorMask(false, false, false, false);
      this.drawMesh(...GRID);
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.EQUAL);
      gl.depthMask(false);
    }
    gl.useProgram(made.program);
    const { at } = made;
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, this.weights);
    const textures = this.textures[scene.mode];
    Object.entries(textures).forEach(([name, texture], k) => this.bind(k, gl.TEXTURE_2D_ARRAY, texture, at(name)));
    this.bind(2, gl.TEXTURE_2D_ARRAY, this.shadows.texture, at("shadows"));
    this.bind(5, gl.TEXTURE_2D, this.weightsTexture, at("neumip_weights"));
    const [first, second] = scene.queries ?? [null, null];
    this.bind(3, gl.TEXTURE_2D, first, at("queries_u_wi"));
    this.bind(4, gl.TEXTURE_2D, second, at("queries_wo_level"));
    gl.uniform1i(at("cosine"), data.cosine ? 1 : 0);
    gl.uniform1i(at("lights"), lights.length);
    gl.uniform3fv(at("light"), lights.flatMap((l) => unit(l.direction)));
    gl.uniform3fv(at("irradiance"), lights.flatMap((l) => l.irradiance));
    gl.uniformMatrix4fv(at("shadow"), false, matrices.flatMap((m) => [...m]));
    gl.uniform2f(at("size"), width, height);
    gl.uniform2f(at("jitter"), ...jitter);
    if (camera) {
      for (const name of ["eye", "forward", "right", "up"]) gl.uniform3fv(at(name), camera[name]);
      gl.uniform1f(at("pitch"), camera.pitch);
      gl.uniform2f(at("tiling"), ...scene.tiling);
      gl.uniform1f(at("texels"), data.resolution[0] * data.resolution[1]);
      gl.uniform1f(at("bias"), scene.bias ?? 0);
    }
    if (mesh) {
      gl.uniformMatrix4fv(at("projection"), false, projection);
      this.drawMesh(...GRID);
      gl.disable(gl.DEPTH_TEST);
      gl.depthMask(true);
    } else this.drawAll();
    return true;
  }

  // Mean of the frames so far and a fresh one.
  blend(fresh, count) {
    const { gl } = this;
    const { width, height } = fresh;
    const [before, after] = [count, count + 1].map((k) => this.target(`mean ${k % 2}`, width, height, { linear: true }));
    const at = this.use(this.blending);
    gl.bindFramebuffer(gl.FRAMEBUFFER, after.frame);
    gl.viewport(0, 0, width, height);
    this.bind(0, gl.TEXTURE_2D, before.texture, at("before"));
    this.bind(1, gl.TEXTURE_2D, fresh.texture, at("fresh"));
    gl.uniform1f(at("share"), 1 / (count + 1));
    this.drawAll();
    return after;
  }

  // Shows a picture in a rectangle of the canvas, [left, bottom, width, height] in its pixels.
  present(picture, view, { exposure = 1, largest = 1, rectangle, reference = picture } = {}) {
    const { gl, canvas } = this;
    const place = rectangle ?? [0, 0, canvas.width, canvas.height];
    const at = this.use(this.presenting);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(...place);
    gl.uniform1i(at("view"), view);
    gl.uniform1i(at("bottom_up"), view === VIEWS.material || view === VIEWS.levels ? 1 : 0);
    gl.uniform4f(at("window"), ...place);
    gl.uniform1f(at("exposure"), exposure);
    gl.uniform1f(at("largest"), largest);
    this.bind(0, gl.TEXTURE_2D, picture.texture, at("picture"));
    this.bind(1, gl.TEXTURE_2D, reference.texture, at("reference"));
    this.drawAll();
  }

  // All values of a target, RGB, in the order of its rows in memory.
  read({ frame, width, height }) {
    const { gl } = this;
    const four = new Float32Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, four);
    const three = new Float32Array(3 * width * height);
    for (let i = 0, k = 0; i < four.length; i += 4) {
      three[k++] = four[i];
      three[k++] = four[i + 1];
      three[k++] = four[i + 2];
    }
    return three;
  }

  // A texture of RGBA values, a pixel an entry.
  values(width, height, four) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA, gl.FLOAT, four);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  // The textures of N queries: [u, wi] and [wo, level, 0], `width` a row.
  ask({ u, wi, wo, level }, width) {
    const count = level.length;
    const height = Math.ceil(count / width);
    const pairs = [new Float32Array(4 * width * height), new Float32Array(4 * width * height)];
    for (let i = 0; i < count; i++) {
      pairs[0].set([u[2 * i], u[2 * i + 1], wi[2 * i], wi[2 * i + 1]], 4 * i);
      pairs[1].set([wo[2 * i], wo[2 * i + 1], level[i], 0], 4 * i);
    }
    return { textures: pairs.map((four) => this.values(width, height, four)), width, height };
  }

  // Answers to N queries given as flat arrays: [3 N].
  answer(queries, mode = "exact") {
    const count = queries.level.length;
    const asked = this.ask(queries, Math.max(1, Math.min(count, 256)));
    const target = this.target("answers", asked.width, asked.height);
    this.draw(target, { queries: asked.textures, mode }, true);
    asked.textures.forEach((texture) => this.gl.deleteTexture(texture));
    return this.read(target).subarray(0, 3 * count);
  }

  // A picture of linear RGB, rows from the top.
  render(scene) {
    const { width, height } = scene;
    const target = this.target("render", width, height, { depth: true });
    this.draw(target, scene, true);
    const values = this.read(target);
    const pixels = new Float32Array(values.length);
    for (let row = 0; row < height; row++) {
      pixels.set(values.subarray(3 * width * row, 3 * width * (row + 1)), 3 * width * (height - 1 - row));
    }
    return { width, height, pixels };
  }
}
