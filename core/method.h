// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "haarlight/core/enum_words.h"

/// @file
/// A method that trades speed for accuracy: its settings from fast to exact, an input made for
/// it, and a truth to measure its error against. A table of methods is a file `*_methods.cpp`
/// beside what it measures; core/method_run.h runs the tables, bench/methods has all of them
/// (docs/numerics/methods.md).
///
///     struct BoxBlur {                       // the input, and what is done with it
///       using Result = Image<float>;
///       explicit BoxBlur(MethodSize size);   // made here: no file, the same on every machine
///       Result run(std::size_t setting);     // timed
///       Result truth();
///       double error(const Result& found, const Result& truth);  // in Method::error_norm
///       MethodScale scale() const;
///       double bytes(std::size_t setting);   // where it is known: moved at least by a run
///     };
///     Method::of<BoxBlur>({.module = "core/picture", .name = "box blur", ...})

namespace haarlight {

/// How large an input is: of `smallest` a test runs every setting with sanitizers; `small` is
/// for a table in seconds; `large` is beyond the caches.
enum class MethodSize { smallest, small, large };
inline constexpr auto kMethodSizeWords =
    std::to_array<std::string_view>({"smallest", "small", "large"});
constexpr std::span<const std::string_view> words_of(MethodSize) { return kMethodSizeWords; }

/// One of three values, by size.
template <class T>
[[nodiscard]] T by_size(MethodSize size, T smallest, T small, T large) {
  return size == MethodSize::smallest ? smallest : size == MethodSize::small ? small : large;
}

/// ||found - truth|| / ||truth||, of results that are rows of numbers.
[[nodiscard]] double relative_l2(std::span<const double> found, std::span<const double> truth);

/// What a run goes over, for TradeoffConditions.
struct MethodScale {
  int lights = 0;
  long long pixels = 0;  ///< or points
};

/// What the table says of a method.
struct MethodWords {
  std::string module;                 ///< its folder: relight/basis
  std::string name;                   ///< the field's term
  std::vector<std::string> settings;  ///< from fast to exact, two or more
  std::string error_norm;             ///< in words, with the unit if there is one
  std::string truth;                  ///< in words: closed form, double sums, ...
  double exact_error = 0.0;           ///< the last setting's error is at most this
  std::string exact_error_from;       ///< why: rounding, the truth's own error, ...
};

/// An input of a method and what can be done with it.
template <class Input>
concept MethodInput = std::constructible_from<Input, MethodSize> &&
    requires(Input& input, std::size_t setting, const typename Input::Result& result) {
  { input.run(setting) } -> std::same_as<typename Input::Result>;
  { input.truth() } -> std::same_as<typename Input::Result>;
  { input.error(result, result) } -> std::same_as<double>;
  { input.scale() } -> std::same_as<MethodScale>;
};

/// An input with the type of its results hidden, as a runner needs it.
class PreparedMethod {
 public:
  PreparedMethod() = default;
  virtual ~PreparedMethod() = default;
  PreparedMethod(const PreparedMethod&) = delete;
  PreparedMethod& operator=(const PreparedMethod&) = delete;

  /// Keeps the result.
  virtual void run(std::size_t setting) = 0;
  /// Of the result of the latest run.
  [[nodiscard]] virtual double error() = 0;
  [[nodiscard]] virtual MethodScale scale() const = 0;
  /// Moved at least by a run of the setting, which has run before; nothing: not counted.
  [[nodiscard]] virtual std::optional<double> bytes(std::size_t setting) = 0;
};

class Method {
 public:
  /// @throws ContractViolation  an empty word, fewer than two settings, two of the same words
  template <MethodInput Input>
  [[nodiscard]] static Method of(MethodWords words) {
    return {std::move(words),
            [](MethodSize size) { return std::make_unique<Of<Input>>(size); }};
  }

  [[nodiscard]] const MethodWords& words() const noexcept { return words_; }
  [[nodiscard]] std::unique_ptr<PreparedMethod> prepare(MethodSize size) const {
    return prepare_(size);
  }

 private:
  using Prepare = std::function<std::unique_ptr<PreparedMethod>(MethodSize)>;
  Method(MethodWords words, Prepare prepare);

  template <MethodInput Input>
  class Of final : public PreparedMethod {
   public:
    explicit Of(MethodSize size) : input_(size) {}
    void run(std::size_t setting) override { found_ = input_.run(setting); }
    double error() override {
      if (!truth_) {
        truth_ = input_.truth();
      }
      return input_.error(*found_, *truth_);
    }
    [[nodiscard]] MethodScale scale() const override { return input_.scale(); }
    std::optional<double> bytes(std::size_t setting) override {
      if constexpr (requires { input_.bytes(setting); }) {
        return input_.bytes(setting);
      } else {
        return std::nullopt;
      }
    }

   private:
    Input input_;
    std::optional<typename Input::Result> found_;
    std::optional<typename Input::Result> truth_;
  };

  MethodWords words_;
  Prepare prepare_;
};

}  // namespace haarlight
