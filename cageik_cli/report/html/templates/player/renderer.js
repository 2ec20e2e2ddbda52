// Draws with WebGL2: a shaded mesh, lines and points.
const MESH_VERTEX = `#version 300 es
uniform mat4 toClip;
in vec3 position, normal;
in float value;
out vec3 facing;
out float level;
void main() { gl_Position = toClip * vec4(position, 1.0); facing = normal; level = value; }`;

const MESH_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 ramp[9], missing, light, eye;
in vec3 facing;
in float level;
out vec4 colour;
void main() {
  float place = clamp(level, 0.0, 1.0) * 8.0;
  int k = min(int(place), 7);
  vec3 paint = level < -0.5 ? missing : mix(ramp[k], ramp[k + 1], place - float(k));
  vec3 n = normalize(facing) * (gl_FrontFacing ? 1.0 : -1.0);
  float shade = 0.38 + 0.50 * max(dot(n, light), 0.0) + 0.18 * max(dot(n, eye), 0.0);
  colour = vec4(paint * shade, 1.0);
}`;

const MARK_VERTEX = `#version 300 es
uniform mat4 toClip;
uniform float size;
in vec3 position;
void main() { gl_Position = toClip * vec4(position, 1.0); gl_PointSize = size; }`;

const MARK_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 paint, rim;
uniform int shape;
out vec4 colour;
void main() {
  vec2 off = abs(2.0 * gl_PointCoord - 1.0);
  float away = shape == 1 ? length(off) : max(off.x, off.y);
  if (shape > 0 && away > 1.0) discard;
  colour = shape > 0 && away > 0.68 ? rim : paint;
}`;

// Whether pictures are drawn without a graphics card, where smooth edges cost too much.
const isSoftware = () => !document.createElement("canvas").getContext("webgl2", { failIfMajorPerformanceCaveat: true });

class Renderer {
  constructor(canvas, faces, cageEdges) {
    const gl = this.gl = canvas.getContext("webgl2", { antialias: !isSoftware(), alpha: false });
    if (!gl) throw new Error("no WebGL2");
    this.mesh = this.build(MESH_VERTEX, MESH_FRAGMENT, ["position", "normal", "value"]);
    this.mark = this.build(MARK_VERTEX, MARK_FRAGMENT, ["position"]);
    this.cageEdgeCount = cageEdges.length;
    this.buffers = {};
    this.setFaces(faces);
    this.sendIndices("cageEdges", cageEdges);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  setFaces(faces) {
    this.faceCount = faces.length;
    this.sendIndices("faces", faces);
  }

  setEdges(edges) {
    this.edgeCount = edges.length;
    this.sendIndices("edges", edges);
  }

  sendIndices(name, indices) {
    const gl = this.gl;
    this.buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
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

  // Uses a program; returns a function from the names of its uniforms to their places.
  use(program, toClip) {
    const gl = this.gl, placeOf = (name) => gl.getUniformLocation(program, name);
    gl.useProgram(program);
    gl.uniformMatrix4fv(placeOf("toClip"), false, toClip);
    return placeOf;
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

  begin(left, width, height, ground) {
    const gl = this.gl;
    gl.viewport(left, 0, width, height);
    gl.scissor(left, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.clearColor(...ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  // `names` of positions, normals and values; `vectors` by the names of uniforms.
  drawMesh(names, toClip, vectors) {
    const gl = this.gl, placeOf = this.use(this.mesh, toClip);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const name in vectors) gl.uniform3fv(placeOf(name), vectors[name]);
    names.forEach((name, place) => this.attach(place, name, place < 2 ? 3 : 1));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.faces);
    gl.drawElements(gl.TRIANGLES, this.faceCount, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  useMarks(name, toClip, { paint, rim = paint, shape = 0, size = 1 }) {
    const gl = this.gl, placeOf = this.use(this.mark, toClip);
    gl.enable(gl.BLEND);
    gl.uniform4fv(placeOf("paint"), paint);
    gl.uniform4fv(placeOf("rim"), rim);
    gl.uniform1i(placeOf("shape"), shape);
    gl.uniform1f(placeOf("size"), size);
    this.attach(0, name, 3);
  }

  // The edges of a mesh that was just drawn, where its surface does not hide them.
  drawEdges(name, toClip) {
    const gl = this.gl;
    gl.depthFunc(gl.LEQUAL);
    this.useMarks(name, toClip, { paint: [0.1, 0.12, 0.15, 0.45] });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.edges);
    gl.drawElements(gl.LINES, this.edgeCount, gl.UNSIGNED_INT, 0);
  }

  // The cage: clear before surfaces, faint behind them.
  drawCage(toClip, colour, pixels) {
    const gl = this.gl;
    for (const [order, opacity] of [[gl.GREATER, 0.22], [gl.LEQUAL, 0.95]]) {
      gl.depthFunc(order);
      gl.depthMask(order === gl.LEQUAL);
      this.useMarks("cage", toClip, { paint: [...colour, opacity] });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.cageEdges);
      gl.drawElements(gl.LINES, this.cageEdgeCount, gl.UNSIGNED_INT, 0);
      this.useMarks("cage", toClip, { paint: [...colour, opacity], shape: 1, size: 5 * pixels });
      gl.drawArrays(gl.POINTS, 0, this.cagePoints);
    }
    gl.depthMask(true);
  }

  uploadCage(cage) {
    this.cagePoints = cage.length / 3;
    this.upload("cage", Float32Array.from(cage));
  }

  // Marks on top of everything: points of a shape, or lines between pairs.
  drawMarks(points, toClip, style) {
    if (!points.length) return;
    const gl = this.gl;
    this.upload("marks", Float32Array.from(points));
    gl.disable(gl.DEPTH_TEST);
    this.useMarks("marks", toClip, style);
    gl.drawArrays(style.shape ? gl.POINTS : gl.LINES, 0, points.length / 3);
    gl.enable(gl.DEPTH_TEST);
  }
}
