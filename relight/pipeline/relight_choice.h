// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"

/// @file
/// Which of the ways to sum pictures takes the least time for a requested error, or reaches the
/// least error in a requested time, by predictions of both. Pure: the predictions are made in
/// relight_costs.h. Method: docs/numerics/relight.md, "Seconds".

namespace haarlight::relight {

/// Where the sums' values come from.
enum class RelightForm {
  file,    ///< the basis file is unpacked in passing, for all pictures of a batch
  memory,  ///< its coefficients are unpacked once (prepared_basis.h)
  half,    ///< all lights are held as half floats (dense_half.h)
};
inline constexpr auto kRelightFormWords =
    std::to_array<std::string_view>({"file", "memory", "half floats"});
constexpr std::span<const std::string_view> words_of(RelightForm) { return kRelightFormWords; }

/// What one form takes and promises, picture by picture and by the number of terms kept.
struct FormCost {
  RelightForm form = RelightForm::file;
  double prepare = 0.0;                      ///< seconds, once for all pictures
  int least_terms = 0;                       ///< of the entries below; the last is all terms
  std::vector<std::vector<double>> seconds;  ///< (pictures, terms): ascends
  std::vector<std::vector<double>> errors;   ///< (pictures, terms): relative bounds; descends
};

struct RelightChoice {
  RelightForm form = RelightForm::file;
  std::vector<int> terms;    ///< (pictures): of every colour
  double seconds = 0.0;      ///< predicted, all pictures and what is prepared for them
  double error = 0.0;        ///< predicted bound, of the worst picture
  bool has_all = true;       ///< every picture keeps all terms
  bool is_within = true;     ///< the requested error, or time, is predicted to be kept
  bool is_predicted = true;  ///< else nothing of what follows is known, nor `error`, `seconds`
  double all_seconds = 0.0;  ///< of all terms, in the form that is cheapest with them
  int fewest = 0;  ///< terms that would keep the requested error, of the worst picture
  double fewest_seconds = 0.0;  ///< what they would take
};

/// A second sum is needed where a picture of fewer terms misses the error that was predicted for
/// it: seldom (docs/numerics/relight.md, "Seconds").
inline constexpr double kSecondSums = 0.02;

/// The form and terms of least expected seconds among those predicted to keep the error: in every
/// form all terms, or for each picture the fewest that keep it, whose expected seconds are theirs
/// and kSecondSums of those of all terms. If none keeps it: all terms, the least error.
/// @param forms  one at least, of the same pictures
[[nodiscard]] RelightChoice choose_within_error(std::span<const FormCost> forms,
                                                double max_error);

/// The form of least error, each picture with the most terms that `seconds` allow it; if the time
/// is too short for every form, the cheapest way there is.
/// @param seconds  of every picture, with its part of what is prepared
[[nodiscard]] RelightChoice choose_within_seconds(std::span<const FormCost> forms,
                                                  double seconds);

/// All terms of one picture, of which nothing is predicted: the sum costs less.
[[nodiscard]] RelightChoice choose_all(int n_lights);

/// One line: what was chosen and why.
struct ChoiceWords {
  std::optional<double> max_error;  ///< that was requested, or:
  std::optional<double> seconds;    ///< of a picture
  int terms_all = 0;                ///< of the picture with the most
  bool is_exact = false;            ///< of an exact file
};
[[nodiscard]] std::string words_of(const RelightChoice& choice, const ChoiceWords& words);

}  // namespace haarlight::relight
