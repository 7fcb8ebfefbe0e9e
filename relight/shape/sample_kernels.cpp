// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/sample_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "core/vector_clones.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;
using Four = double __attribute__((vector_size(32)));
constexpr int kFour = 4;
constexpr int kSums = 9;

void load(const double* from, Four& to) { std::memcpy(&to, from, sizeof(Four)); }

void terms_at(const SampleColumns& s, int i, double (&terms)[kSums]) {
  const double wx = s.w[i] * s.x[i];
  const double wy = s.w[i] * s.y[i];
  const double wz = s.w[i] * s.z[i];
  terms[0] = wx * s.x[i];
  terms[1] = wx * s.y[i];
  terms[2] = wx * s.z[i];
  terms[3] = wy * s.y[i];
  terms[4] = wy * s.z[i];
  terms[5] = wz * s.z[i];
  terms[6] = wx * s.value[i];
  terms[7] = wy * s.value[i];
  terms[8] = wz * s.value[i];
}

/// Of whole fours, at least one.
HAARLIGHT_CLONES("arch=x86-64-v3")
void sum_fours(const SampleColumns& s, int n, double (&parts)[kSums][kFour]) {
  Four sums[kSums] = {};
  for (int i = 0; i < n; i += kFour) {
    Four x, y, z, w, value;
    load(s.x + i, x);
    load(s.y + i, y);
    load(s.z + i, z);
    load(s.w + i, w);
    load(s.value + i, value);
    const Four wx = w * x;
    const Four wy = w * y;
    const Four wz = w * z;
    const Four terms[kSums] = {wx * x, wx * y,     wx * z,     wy * y,    wy * z,
                               wz * z, wx * value, wy * value, wz * value};
    for (int k = 0; k < kSums; ++k) {
      sums[k] = i == 0 ? terms[k] : sums[k] + terms[k];
    }
  }
  std::memcpy(parts, sums, sizeof(sums));
}

/// Adds the last n % 4 terms as Eigen does: two to the parts, and one to their sum.
template <class Term>
double end_of_sum(const double* parts, int n, const Term& term) {
  const int whole = n / kFour * kFour;
  double even = parts[0] + parts[2];
  double odd = parts[1] + parts[3];
  if (n - whole >= 2) {
    even += term(whole);
    odd += term(whole + 1);
  }
  const double sum = even + odd;
  return n % 2 != 0 ? sum + term(n - 1) : sum;
}

HAARLIGHT_CLONES("arch=x86-64-v3")
void residual_fours(const double* w, const double* r, int n, double (&parts)[2][kFour]) {
  Four square = {};
  Four weight = {};
  for (int i = 0; i < n; i += kFour) {
    Four wi, ri;
    load(w + i, wi);
    load(r + i, ri);
    const Four term = wi * (ri * ri);
    square = i == 0 ? term : square + term;
    weight = i == 0 ? wi : weight + wi;
  }
  std::memcpy(parts[0], &square, sizeof(Four));
  std::memcpy(parts[1], &weight, sizeof(Four));
}

HAARLIGHT_CLONES("arch=x86-64-v4")
int count_positive(const double* values, int n) {
  int sum = 0;
  for (int i = 0; i < n; ++i) {
    sum += values[i] > 0.0 ? 1 : 0;
  }
  return sum;
}

}  // namespace

SampleSums weighted_sums(const SampleColumns& samples) {
  const int n = samples.n;
  double sums[kSums] = {};
  if (n >= kFour) {
    const int whole = n / kFour * kFour;
    double parts[kSums][kFour];
    sum_fours(samples, whole, parts);
    double last[3][kSums] = {};
    for (int i = whole; i < n; ++i) {
      terms_at(samples, i, last[i - whole]);
    }
    for (int k = 0; k < kSums; ++k) {
      sums[k] = end_of_sum(parts[k], n, [&](int i) { return last[i - whole][k]; });
    }
  } else {
    for (int i = 0; i < n; ++i) {
      double terms[kSums];
      terms_at(samples, i, terms);
      for (int k = 0; k < kSums; ++k) {
        sums[k] = i == 0 ? terms[k] : sums[k] + terms[k];
      }
    }
  }
  return {sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7], sums[8]};
}

ResidualSums residual_sums(const double* w, const double* r, int n) {
  const auto square = [&](int i) { return w[i] * (r[i] * r[i]); };
  const auto weight = [&](int i) { return w[i]; };
  ResidualSums sums;
  sums.n_used = count_positive(w, n);
  if (n >= kFour) {
    double parts[2][kFour];
    residual_fours(w, r, n / kFour * kFour, parts);
    sums.square = end_of_sum(parts[0], n, square);
    sums.weight = end_of_sum(parts[1], n, weight);
  } else {
    for (int i = 0; i < n; ++i) {
      sums.square += square(i);
      sums.weight += weight(i);
    }
  }
  return sums;
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void find_residuals(const SampleColumns& samples, const Vector3d& b, double* r, float* ranked) {
  const SampleColumns s = samples;
  const double bx = b.x();
  const double by = b.y();
  const double bz = b.z();
  for (int i = 0; i < s.n; ++i) {
    const double left = std::abs(s.value[i] - bx * s.x[i] - by * s.y[i] - bz * s.z[i]);
    r[i] = left;
    ranked[i] = static_cast<float>(left);
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void to_floats(const double* from, int n, float* to) {
  for (int i = 0; i < n; ++i) {
    to[i] = static_cast<float>(from[i]);
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
int count_within(const float* values, int n, float limit) {
  int sum = 0;
  for (int i = 0; i < n; ++i) {
    sum += values[i] <= limit ? 1 : 0;
  }
  return sum;
}

HAARLIGHT_CLONES("arch=x86-64-v4")
float largest_within(const float* values, int n, float limit) {
  // Floats that are not negative are ordered like their bits, and integers may be reordered.
  const auto most = std::bit_cast<std::int32_t>(limit);
  std::int32_t largest = 0;
  for (int i = 0; i < n; ++i) {
    const auto bits = std::bit_cast<std::int32_t>(values[i]);
    largest = std::max(largest, bits <= most ? bits : 0);
  }
  return std::bit_cast<float>(largest);
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void keep_within(const float* values, int n, float limit, std::uint8_t* kept,
                 std::uint8_t* changed) {
  for (int i = 0; i < n; ++i) {
    const std::uint8_t is_kept = values[i] <= limit ? 1 : 0;
    changed[i] = static_cast<std::uint8_t>(is_kept ^ kept[i]);
    kept[i] = is_kept;
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void huber_weights(const double* r, int n, double scale, double c, double* w) {
  for (int i = 0; i < n; ++i) {
    const double t = r[i] / scale / c;
    w[i] = t > 1.0 ? 1.0 / t : 1.0;
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void cauchy_weights(const double* r, int n, double scale, double c, double* w) {
  for (int i = 0; i < n; ++i) {
    const double t = r[i] / scale / c;
    w[i] = 1.0 / (1.0 + t * t);
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void tukey_weights(const double* r, int n, double scale, double c, double* w) {
  for (int i = 0; i < n; ++i) {
    const double t = r[i] / scale / c;
    const double square = (1.0 - t * t) * (1.0 - t * t);
    w[i] = t < 1.0 ? square : 0.0;
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void find_products(const SampleColumns& samples, const Vector3d& b, double* products) {
  const SampleColumns s = samples;
  const double bx = b.x();
  const double by = b.y();
  const double bz = b.z();
  for (int i = 0; i < s.n; ++i) {
    products[i] = bx * s.x[i] + by * s.y[i] + bz * s.z[i];
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void aim_at(const LightColumns& lights, const Vector3d& point, bool are_lambertian,
            double* const direction[3], double* scale, double* lobe) {
  const double px = point.x();
  const double py = point.y();
  const double pz = point.z();
  const double* at_x = lights.position[0];
  const double* at_y = lights.position[1];
  const double* at_z = lights.position[2];
  const double* axis_x = lights.axis[0];
  const double* axis_y = lights.axis[1];
  const double* axis_z = lights.axis[2];
  double* out_x = direction[0];
  double* out_y = direction[1];
  double* out_z = direction[2];
  const int n = lights.n;
  for (int j = 0; j < n; ++j) {
    double x = at_x[j] - px;
    double y = at_y[j] - py;
    double z = at_z[j] - pz;
    const double square = x * x + y * y + z * z;
    const double inverse = 1.0 / std::sqrt(square);
    x *= inverse;
    y *= inverse;
    z *= inverse;
    const double cosine = -(axis_x[j] * x + axis_y[j] * y + axis_z[j] * z);
    const double over = square / cosine;
    const double lit = cosine > 0.0 ? over : 0.0;
    out_x[j] = x;
    out_y[j] = y;
    out_z[j] = z;
    lobe[j] = cosine;
    scale[j] = are_lambertian ? lit : square;
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void add_channel(const float* raw, const double* gain, int n, double* value) {
  for (int j = 0; j < n; ++j) {
    value[j] += double{raw[j]} * gain[j];
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void scale_mean(const double* scale, int n_channels, int n, double* value) {
  const double all = n_channels;
  for (int j = 0; j < n; ++j) {
    value[j] *= scale[j] / all;
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void mark_reaching(const float* raw, const float* limit, int n, std::uint8_t* marks) {
  for (int j = 0; j < n; ++j) {
    marks[j] = static_cast<std::uint8_t>(marks[j] | (raw[j] >= limit[j] ? 1 : 0));
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
int leave_out(const double* scale, const std::uint8_t* clipped, int n, std::uint8_t* left_out) {
  int n_clipped = 0;
  for (int j = 0; j < n; ++j) {
    const int is_lit = scale[j] > 0.0 ? 1 : 0;
    left_out[j] = static_cast<std::uint8_t>(clipped[j] | (1 - is_lit));
    n_clipped += clipped[j] & is_lit;
  }
  return n_clipped;
}

}  // namespace haarlight::relight
