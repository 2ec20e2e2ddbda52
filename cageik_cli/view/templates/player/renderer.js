// Draws with WebGL2: a shaded mesh, lines and points.
const MESH_VERTEX = `#version 300 es
uniform mat4 toClip;
in vec3 position, normal, tint;
in float value;
out vec3 facing, hue;
out float level;
void main() { gl_Position = toClip * vec4(position, 1.0); facing = normal; level = value; hue = tint; }`;

const MESH_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 ramp[9], missing, light, eye;
uniform float tinted, opacity;
in vec3 facing, hue;
in float level;
out vec4 colour;
void main() {
  float place = clamp(level, 0.0, 1.0) * 8.0;
  int k = min(int(place), 7);
  vec3 paint = level < -0.5 ? missing : mix(ramp[k], ramp[k + 1], place - float(k));
  paint = mix(paint, hue, tinted);
  vec3 n = normalize(facing) * (gl_FrontFacing ? 1.0 : -1.0);
  float shade = 0.38 + 0.50 * max(dot(n, light), 0.0) + 0.18 * max(dot(n, eye), 0.0);
  colour = vec4(paint * shade, opacity);
}`;

// Of marks, which are lifted toward the eye by a share, and of the ground, which is moved by `offset`; what is not set is zero.
const MARK_VERTEX = `#version 300 es
uniform mat4 toClip;
uniform vec3 offset;
uniform vec4 lift;
uniform float size;
in vec3 position;
out vec3 place;
void main() { place = position + offset; gl_Position = toClip * vec4(mix(place, lift.xyz, lift.w), 1.0); gl_PointSize = size; }`;

const GRID_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 paint;
uniform vec3 foot;
uniform float reach;
in vec3 place;
out vec4 colour;
void main() {
  float left = max(0.0, 1.0 - distance(place, foot) / reach);
  colour = vec4(paint.rgb, paint.a * left * left);
}`;

// Of ghosts: a colour that is darker along the outline.
const GHOST_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 paint;
uniform vec3 light;
in vec3 facing;
out vec4 colour;
void main() {
  vec3 n = normalize(facing) * (gl_FrontFacing ? 1.0 : -1.0);
  colour = vec4(paint.rgb * (0.72 + 0.35 * max(dot(n, light), 0.0)), paint.a);
}`;

const MARK_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 paint, rim;
uniform float shape;
out vec4 colour;
void main() {
  vec2 off = abs(2.0 * gl_PointCoord - 1.0);
  float away = shape == 1.0 ? length(off) : max(off.x, off.y);
  if (shape > 0.0 && away > 1.0) discard;
  colour = shape > 0.0 && away > 0.68 ? rim : paint;
}`;

const WHITE = [1, 1, 1, 1], BLACK = [0, 0, 0, 1], RED = [0.85, 0.25, 0.1, 1], VIOLET = [0.62, 0.12, 0.72, 1];

// Whether pictures are drawn without a graphics card, where smooth edges take most of the time. Not all browsers say so
// by refusing `failIfMajorPerformanceCaveat`; the name of what draws does.
const isSoftware = (gl) => /swiftshader|llvmpipe|software|basic render/i.test(gl?.getParameter(gl.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));

class Renderer {
  constructor(canvas, faces, cageEdges) {
    this.isSlow = isSoftware(document.createElement("canvas").getContext("webgl2"));
    const gl = this.gl = canvas.getContext("webgl2", { antialias: !this.isSlow, alpha: false });
    if (!gl) throw new Error("no WebGL2");
    this.mesh = this.build(MESH_VERTEX, MESH_FRAGMENT, ["position", "normal", "value", "tint"]);
    this.mark = this.build(MARK_VERTEX, MARK_FRAGMENT, ["position"]);
    this.ghost = this.build(MESH_VERTEX, GHOST_FRAGMENT, ["position", "normal"]);
    this.grid = this.build(MARK_VERTEX, GRID_FRAGMENT, ["position"]);
    Object.assign(this, { buffers: {}, counts: {} });
    this.sendIndices("faces", faces);
    this.sendIndices("cageEdges", cageEdges);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // Sends triangles or lines, as indices, to the buffer of this name.
  sendIndices(name, indices) {
    const gl = this.gl;
    this.buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    this.counts[name] = indices.length;
  }

  drawIndices(kind, name) {
    const gl = this.gl;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[name]);
    gl.drawElements(kind, this.counts[name], gl.UNSIGNED_INT, 0);
  }

  build(vertex, fragment, attributes) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    attributes.forEach((name, k) => gl.bindAttribLocation(program, k, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "WebGL2 failed");
    return program;
  }

  // Uses a program with uniforms by their names: numbers, vectors, or a 4 x 4 matrix.
  use(program, uniforms) {
    const gl = this.gl;
    gl.useProgram(program);
    for (const [name, value] of Object.entries({ toClip: this.toClip, ...uniforms })) {
      const place = gl.getUniformLocation(program, name), size = value.length;
      if (!size) gl.uniform1f(place, value);
      else if (size === 16) gl.uniformMatrix4fv(place, false, value);
      else if (size === 4) gl.uniform4fv(place, value);
      else gl.uniform3fv(place, value);
    }
  }

  // Sends an array to the buffer of this name.
  upload(name, values) {
    const gl = this.gl;
    this.buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
  }

  attach(place, name, size) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
  }

  // Begins a part of the picture, which a matrix projects to; sizes of marks are in `pixels`.
  begin({ left, width, height, ground, toClip, pixels, isSolid, lift }) {
    const gl = this.gl;
    Object.assign(this, { toClip, pixels, isSolid, lift });
    gl.viewport(left, 0, width, height);
    gl.scissor(left, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.clearColor(...ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  // `names` of positions, normals, values and perhaps colours of the file.
  drawMesh(names, uniforms) {
    const gl = this.gl;
    this.use(this.mesh, uniforms);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    names.forEach((name, place) => this.attach(place, name, place === 2 ? 1 : 3));
    if (uniforms.opacity < 1) {
      // Of what is seen through, too, only the front is drawn.
      gl.colorMask(false, false, false, false);
      this.drawIndices(gl.TRIANGLES, "faces");
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.LEQUAL);
      gl.enable(gl.BLEND);
    }
    this.drawIndices(gl.TRIANGLES, "faces");
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  // A mesh that is seen through, of `names` of positions and normals; where it is that of a surface before, that is in front.
  drawGhost(names, paint, light) {
    const gl = this.gl;
    this.use(this.ghost, { paint, light });
    names.forEach((name, place) => this.attach(place, name, 3));
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(2, 4);
    // Only its nearest surface has a colour.
    gl.colorMask(false, false, false, false);
    gl.depthFunc(gl.LESS);
    this.drawIndices(gl.TRIANGLES, "faces");
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND);
    gl.depthFunc(gl.EQUAL);
    this.drawIndices(gl.TRIANGLES, "faces");
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  // Lines of the ground, which fade away from `foot` until `reach`; they hide nothing.
  drawGrid(name, lines, uniforms) {
    const gl = this.gl;
    if (!this.buffers[name]) this.upload(name, lines);
    this.use(this.grid, uniforms);
    gl.enable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.depthMask(false);
    this.attach(0, name, 3);
    gl.drawArrays(gl.LINES, 0, lines.length / 3);
    gl.depthMask(true);
  }

  useMarks(name, { paint, rim = paint, shape = 0, size = 1, lift = [0, 0, 0, 0] }) {
    this.use(this.mark, { paint, rim, shape, size: size * this.pixels, lift });
    this.gl.enable(this.gl.BLEND);
    this.attach(0, name, 3);
  }

  // The edges of a mesh that was just drawn, where its surface does not hide them.
  drawEdges(name) {
    const gl = this.gl;
    gl.depthFunc(gl.LEQUAL);
    this.useMarks(name, { paint: [0.1, 0.12, 0.15, 0.45] });
    this.drawIndices(gl.LINES, "edges");
  }

  // The cage: clear before surfaces, faint behind them, unless they are seen through.
  drawCage(colour) {
    const gl = this.gl;
    for (const [order, opacity] of [[gl.GREATER, this.isSolid ? 0.22 : 0.6], [gl.LEQUAL, 0.95]]) {
      const paint = [...colour, opacity];
      gl.depthFunc(order);
      gl.depthMask(order === gl.LEQUAL);
      this.useMarks("cage", { paint });
      this.drawIndices(gl.LINES, "cageEdges");
      this.useMarks("cage", { paint, shape: 1, size: 5 });
      gl.drawArrays(gl.POINTS, 0, this.cagePoints);
    }
    gl.depthMask(true);
  }

  uploadCage(cage) {
    this.cagePoints = cage.length / 3;
    this.upload("cage", Float32Array.from(cage));
  }

  // Marks on top of everything, which are given as a list of coordinates. Those that the surface hides are faint behind it.
  drawMarks(kind, points, { isHidden = false, paint, rim = paint, ...style }) {
    if (!points.length) return;
    const gl = this.gl, isFaint = isHidden && this.isSolid;
    this.upload("marks", Float32Array.from(points));
    gl.depthMask(false);
    for (const [order, opacity] of isFaint ? [[gl.GREATER, 0.22], [gl.LEQUAL, 1]] : [[gl.ALWAYS, 1]]) {
      const fade = ([r, g, b, a]) => [r, g, b, a * opacity];
      gl.depthFunc(order);
      this.useMarks("marks", { ...style, paint: fade(paint), rim: fade(rim), lift: isFaint ? this.lift : [0, 0, 0, 0] });
      gl.drawArrays(kind, 0, points.length / 3);
    }
    gl.depthMask(true);
  }

  drawDots(points, paint, size, rim = WHITE, isHidden = false) { this.drawMarks(this.gl.POINTS, points, { paint, rim, size, shape: 1, isHidden }); }

  drawSquares(points, paint, size, rim = WHITE, isHidden = false) { this.drawMarks(this.gl.POINTS, points, { paint, rim, size, shape: 2, isHidden }); }

  // Lines between pairs of points.
  drawLines(points, paint) { this.drawMarks(this.gl.LINES, points, { paint }); }

  drawTriangles(points, paint) { this.drawMarks(this.gl.TRIANGLES, points, { paint }); }
}
