layout(location = 0) in vec2 parameter;
uniform mat4 projection;
out vec2 st;
// The pass that fills the depth and the pass that is tested against it agree to the last bit.
invariant gl_Position;

void main() {
  st = parameter;
  gl_Position = shape == TORUS || shape == CLOTH
    ? projection * vec4(surface(parameter), 1.0)
    : vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}
