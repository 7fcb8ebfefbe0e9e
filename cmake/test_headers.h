// SPDX-License-Identifier: Apache-2.0
// System headers that many tests include (cmake/HaarlightHeaders.cmake).
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#ifdef __clang__  // g++ wants FMT_SHARED defined in all sources, or in none
#include <fmt/format.h>
#endif
