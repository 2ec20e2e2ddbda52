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
uniform bool isFlat;
in vec3 facing;
in float level;
out vec4 colour;
void main() {
  float place = clamp(level, 0.0, 1.0) * 8.0;
  int k = min(int(place), 7);
  vec3 paint = level < -0.5 ? missing : mix(ramp[k], ramp[k + 1], place - float(k));
  vec3 n = normalize(facing) * (gl_FrontFacing ? 1.0 : -1.0);
  float shade = isFlat ? 1.0 : 0.38 + 0.50 * max(dot(n, light), 0.0) + 0.18 * max(dot(n, eye), 0.0);
  colour = vec4(paint * shade, 1.0);
}`;

const MARK_VERTEX = `#version 300 es
uniform mat4 toClip;
uniform float size;
in vec3 position;
void main() { gl_Position = toClip * vec4(position, 1.0); gl_PointSize = size; }`;

const MARK_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 paint;
uniform vec4 rim;
uniform int shape;
out vec4 colour;
void main() {
  vec2 off = abs(2.0 * gl_PointCoord - 1.0);
  float away = shape == 1 ? length(off) : max(off.x, off.y);
  if (shape > 0 && away > 1.0) discard;
  colour = shape > 0 && away > 0.68 ? rim : paint;
}`;

// Whether pictures are drawn without a graphics card, where smooth edges cost too much.
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)).toLowerCase() : "";
  return ["swiftshader", "llvmpipe", "software"].some((one) => name.includes(one));
}

class Renderer {
  constructor(canvas, faces, cageEdges) {
    const gl = this.gl = canvas.getContext("webgl2", { antialias: !isSoftware(), alpha: false });
    if (!gl) throw new Error("no WebGL2");
    this.mesh = this.build(MESH_VERTEX, MESH_FRAGMENT, ["position", "normal", "value"]);
    this.mark = this.build(MARK_VERTEX, MARK_FRAGMENT, ["position"]);
    this.faceCount = faces.length;
    this.edgeCount = cageEdges.length;
    this.buffers = {};
    for (const [name, indices] of [["faces", faces], ["edges", cageEdges]]) {
      this.buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[name]);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    }
    gl.enable(gl.DEPTH_TEST);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
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
    const uniforms = {};
    for (let k = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; k >= 0; k--) {
      const { name } = gl.getActiveUniform(program, k);
      uniforms[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
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

  drawMesh(names, toClip, { ramp, missing, light, eye }) {
    const gl = this.gl, { program, uniforms } = this.mesh;
    gl.useProgram(program);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.uniformMatrix4fv(uniforms.toClip, false, toClip);
    gl.uniform3fv(uniforms.ramp, ramp);
    gl.uniform3fv(uniforms.missing, missing);
    gl.uniform3fv(uniforms.light, light);
    gl.uniform3fv(uniforms.eye, eye);
    gl.uniform1i(uniforms.isFlat, 0);
    this.attach(0, names.positions, 3);
    this.attach(1, names.normals, 3);
    this.attach(2, names.values, 1);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.faces);
    gl.drawElements(gl.TRIANGLES, this.faceCount, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(2);
  }

  useMarks(name, toClip, { paint, rim = paint, shape = 0, size = 1 }) {
    const gl = this.gl, { program, uniforms } = this.mark;
    gl.useProgram(program);
    gl.enable(gl.BLEND);
    gl.uniformMatrix4fv(uniforms.toClip, false, toClip);
    gl.uniform4fv(uniforms.paint, paint);
    gl.uniform4fv(uniforms.rim, rim);
    gl.uniform1i(uniforms.shape, shape);
    gl.uniform1f(uniforms.size, size);
    this.attach(0, name, 3);
  }

  // The cage: clear before surfaces, faint behind them.
  drawCage(toClip, colour, pixels) {
    const gl = this.gl, count = this.edgeCount;
    for (const [order, opacity] of [[gl.GREATER, 0.22], [gl.LEQUAL, 0.95]]) {
      gl.depthFunc(order);
      gl.depthMask(order === gl.LEQUAL);
      this.useMarks("cage", toClip, { paint: [...colour, opacity] });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.edges);
      gl.drawElements(gl.LINES, count, gl.UNSIGNED_INT, 0);
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
