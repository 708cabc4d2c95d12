/* The image formation of framework/kernels/reference.py, in three passes: every Gaussian to the
   screen, quads blended from the farthest to the nearest, sums to colours. */

const PROJECT = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D splats;
uniform highp sampler2D bands;
uniform mat3 rotation;
uniform vec3 shift, eye, ranges;
uniform vec4 lens; // fx, fy, cx, cy in pixels of the target
uniform vec2 size;
uniform float dilation, softness; // pixels^2
uniform int rest, banded, splatsPerRow, bandsPerRow;
in uint index;
out vec4 place; // centre, half-axis of one standard deviation
out vec4 shape; // the other half-axis, standard deviations to alpha = 1/255, opacity
out vec4 colour; // and depth

vec3 dir;
int at;

vec3 band(int k, float range) {
  int i = at * rest + k - 1;
  vec3 q = (255.0 * texelFetch(bands, ivec2(i % bandsPerRow, i / bandsPerRow), 0).rgb - 128.0) / 127.0;
  return range * q * abs(q);
}

vec3 harmonics() {
  float x = dir.x, y = dir.y, z = dir.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 sum = 0.4886025119029199 * (z * band(2, ranges.x) - y * band(1, ranges.x) - x * band(3, ranges.x));
  if (rest > 3) {
    sum += 1.0925484305920792 * (x * y * band(4, ranges.y) - y * z * band(5, ranges.y) - x * z * band(7, ranges.y));
    sum += 0.31539156525252005 * (2.0 * zz - xx - yy) * band(6, ranges.y);
    sum += 0.5462742152960396 * (xx - yy) * band(8, ranges.y);
  }
  if (rest > 8) {
    sum -= 0.5900435899266435 * (y * (3.0 * xx - yy) * band(9, ranges.z) + x * (xx - 3.0 * yy) * band(15, ranges.z));
    sum += 2.890611442640554 * x * y * z * band(10, ranges.z);
    sum -= 0.4570457994644658 * (4.0 * zz - xx - yy) * (y * band(11, ranges.z) + x * band(13, ranges.z));
    sum += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * band(12, ranges.z);
    sum += 1.445305721320277 * z * (xx - yy) * band(14, ranges.z);
  }
  return sum;
}

void main() {
  at = int(index);
  place = shape = colour = vec4(0.0);
  ivec2 texel = ivec2(4 * (at % splatsPerRow), at / splatsPerRow);
  vec4 first = texelFetch(splats, texel, 0);
  vec3 p = rotation * first.xyz + shift;
  vec2 centre = lens.xy * p.xy / p.z + lens.zw;
  if (any(greaterThan(abs(centre - 0.5 * size), 0.75 * size))) return;
  vec4 q = texelFetch(splats, texel + ivec2(1, 0), 0);
  vec3 scales = texelFetch(splats, texel + ivec2(2, 0), 0).xyz;
  float w = q.x, x = q.y, y = q.z, z = q.w;
  mat3 axes = mat3(
    vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)) * scales.x,
    vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)) * scales.y,
    vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)) * scales.z
  );
  mat3 rows = transpose(rotation);
  vec3 a = (lens.x / p.z * (rows[0] - p.x / p.z * rows[2])) * axes;
  vec3 b = (lens.y / p.z * (rows[1] - p.y / p.z * rows[2])) * axes;
  float xx = dot(a, a) + dilation, yy = dot(b, b) + dilation, xy = dot(a, b);
  float before = xx * yy - xy * xy, opacity = first.w;
  xx += softness;
  yy += softness;
  float area = xx * yy - xy * xy;
  if (softness > 0.0) opacity *= sqrt(before / area);
  if (opacity < 1.0 / 255.0) return;
  float half_ = 0.5 * (xx - yy), radius = sqrt(half_ * half_ + xy * xy), major = 0.5 * (xx + yy) + radius;
  vec2 axis = half_ >= 0.0 ? vec2(radius + half_, xy) : vec2(xy, radius - half_);
  axis = radius > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
  place = vec4(centre, axis * sqrt(major));
  shape = vec4(vec2(-axis.y, axis.x) * sqrt(area / major), sqrt(2.0 * log(255.0 * opacity)), opacity);
  vec3 rgb = texelFetch(splats, texel + ivec2(3, 0), 0).rgb;
  dir = normalize(first.xyz - eye);
  if (rest > 0 && at < banded) rgb += harmonics();
  colour = vec4(max(rgb, 0.0), p.z);
}`;

const SPLAT = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D projected; // three texels each, as they came out of the first pass
uniform int chunk, perRow, count;
uniform vec2 size;
out vec2 offset;
flat out vec4 tint;
flat out float opacity;
void main() {
  int i = gl_InstanceID * chunk + (gl_VertexID >> 2);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside
  if (i >= count) return;
  ivec2 texel = ivec2(3 * (i % perRow), i / perRow);
  vec4 shape = texelFetch(projected, texel + ivec2(1, 0), 0);
  if (shape.z == 0.0) return;
  vec4 place = texelFetch(projected, texel, 0);
  tint = texelFetch(projected, texel + ivec2(2, 0), 0);
  offset = (2.0 * vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) - 1.0) * shape.z;
  opacity = shape.w;
  vec2 pixel = place.xy + offset.x * place.zw + offset.y * shape.xy;
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

const BLEND = `#version 300 es
precision highp float;
uniform int mode;
in vec2 offset;
flat in vec4 tint;
flat in float opacity;
out vec4 sum;
void main() {
  float alpha = opacity * exp(-0.5 * dot(offset, offset));
  if (alpha < 1.0 / 255.0) discard;
  alpha = min(alpha, 0.99);
  sum = mode == 0 ? vec4(tint.rgb * alpha, alpha) : mode == 1 ? vec4(tint.w * alpha, 0.0, 0.0, alpha) : vec4(1.0);
}`;

const COVER = `#version 300 es
void main() { gl_Position = vec4(4.0 * float(gl_VertexID & 1) - 1.0, 2.0 * float(gl_VertexID & 2) - 1.0, 0.0, 1.0); }`;

const RESOLVE = `#version 300 es
precision highp float;
uniform highp sampler2D sums;
uniform vec3 background, exposure, ramp[9];
uniform vec4 region; // of the target, pixels
uniform vec2 range;
uniform int mode;
uniform bool exact;
out vec4 result;
vec3 ramped(float t) {
  float k = clamp(t, 0.0, 1.0) * 8.0;
  int i = min(int(k), 7);
  return mix(ramp[i], ramp[i + 1], k - float(i));
}
void main() {
  vec2 spot = gl_FragCoord.xy - region.xy;
  vec4 sum = exact ? texelFetch(sums, ivec2(spot), 0) : texture(sums, spot / region.zw);
  vec3 rgb = exposure * (sum.rgb + (1.0 - sum.a) * background);
  if (mode == 1) {
    float depth = sum.r / max(sum.a, 1e-6);
    rgb = mix(vec3(0.5), ramped((1.0 / depth - 1.0 / range.y) / (1.0 / range.x - 1.0 / range.y)), min(1.0, 2.0 * sum.a));
  }
  if (mode == 2) rgb = ramped(log2(1.0 + sum.r) / log2(1.0 + range.y));
  result = vec4(rgb, 1.0);
}`;

/* viridis (van der Walt and Smith 2015) at ninths: even to the eye, also without colours */
const RAMP = ["440154", "472d7b", "3b528b", "2c728e", "21918c", "28ae80", "5ec962", "addc30", "fde725"];
