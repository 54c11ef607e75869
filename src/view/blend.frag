layout(location = 0) out vec4 colour;
uniform highp sampler2D before, fresh;
uniform float share;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  colour = mix(texelFetch(before, pixel, 0), texelFetch(fresh, pixel, 0), share);
}
