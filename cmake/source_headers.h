// SPDX-License-Identifier: Apache-2.0
// System headers that many sources include (cmake/HaarlightHeaders.cmake).
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <numbers>
#include <numeric>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#ifdef __clang__  // g++ wants FMT_SHARED defined in all sources, or in none
#include <fmt/format.h>
#endif
