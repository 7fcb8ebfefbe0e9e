// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_choice.h"

#include <algorithm>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// A form with chosen entries of each picture.
RelightChoice with_entries(const FormCost& form, const std::vector<std::size_t>& entries) {
  RelightChoice choice;
  choice.form = form.form;
  choice.seconds = choice.all_seconds = form.prepare;
  for (std::size_t e = 0; e < entries.size(); ++e) {
    choice.terms.push_back(form.least_terms + static_cast<int>(entries[e]));
    choice.seconds += form.seconds[e][entries[e]];
    choice.all_seconds += form.seconds[e].back();
    choice.error = std::max(choice.error, form.errors[e][entries[e]]);
    choice.has_all = choice.has_all && entries[e] + 1 == form.seconds[e].size();
  }
  return choice;
}

std::vector<std::size_t> all_entries(const FormCost& form) {
  std::vector<std::size_t> entries;
  entries.reserve(form.seconds.size());
  for (const std::vector<double>& seconds : form.seconds) {
    entries.push_back(seconds.size() - 1);
  }
  return entries;
}

/// Of one form, the cheaper of all terms and the fewest; none: it cannot keep the error.
std::optional<RelightChoice> within_error(const FormCost& form, double max_error) {
  std::vector<std::size_t> entries;
  for (const std::vector<double>& errors : form.errors) {
    const auto kept = std::find_if(errors.begin(), errors.end(),
                                   [max_error](double error) { return error <= max_error; });
    if (kept == errors.end()) {
      return std::nullopt;
    }
    entries.push_back(static_cast<std::size_t>(kept - errors.begin()));
  }
  RelightChoice fewest = with_entries(form, entries);
  RelightChoice all = with_entries(form, all_entries(form));
  fewest.fewest = all.fewest = *std::max_element(fewest.terms.begin(), fewest.terms.end());
  fewest.fewest_seconds = all.fewest_seconds = fewest.seconds;
  const double sums = all.seconds - form.prepare;
  return fewest.seconds + kSecondSums * sums < all.seconds ? fewest : all;
}

/// Of the form that is cheapest with all terms.
double least_seconds_of_all(std::span<const FormCost> forms) {
  double least = std::numeric_limits<double>::infinity();
  for (const FormCost& form : forms) {
    least = std::min(least, with_entries(form, all_entries(form)).seconds);
  }
  return least;
}

double expected_seconds(const RelightChoice& choice, const FormCost& form) {
  return choice.has_all ? choice.seconds
                        : choice.seconds + kSecondSums * (choice.all_seconds - form.prepare);
}

/// How many entries the time allows each picture; none: not one.
std::optional<std::vector<std::size_t>> within_seconds(const FormCost& form, double seconds) {
  const double each = seconds - form.prepare / double(form.seconds.size());
  std::vector<std::size_t> entries;
  for (const std::vector<double>& of : form.seconds) {
    const auto above = std::upper_bound(of.begin(), of.end(), each);
    if (above == of.begin()) {
      return std::nullopt;
    }
    entries.push_back(static_cast<std::size_t>(above - of.begin()) - 1);
  }
  return entries;
}

void require_forms(std::span<const FormCost> forms) {
  HAARLIGHT_EXPECTS(!forms.empty() && !forms[0].seconds.empty(), "a form and a picture");
  for (const FormCost& form : forms) {
    HAARLIGHT_EXPECTS(form.seconds.size() == forms[0].seconds.size() &&
                          form.errors.size() == form.seconds.size(),
                      "forms of the same pictures");
    for (std::size_t e = 0; e < form.seconds.size(); ++e) {
      HAARLIGHT_EXPECTS(
          !form.seconds[e].empty() && form.seconds[e].size() == form.errors[e].size(),
          "seconds and an error for every number of terms");
    }
  }
}

}  // namespace

RelightChoice choose_within_error(std::span<const FormCost> forms, double max_error) {
  require_forms(forms);
  std::optional<RelightChoice> best;
  double least = 0.0;
  for (const FormCost& form : forms) {
    std::optional<RelightChoice> found = within_error(form, max_error);
    if (found && (!best || expected_seconds(*found, form) < least)) {
      least = expected_seconds(*found, form);
      best = std::move(found);
    }
  }
  if (best) {
    best->all_seconds = least_seconds_of_all(forms);
    return *best;
  }
  for (const FormCost& form : forms) {
    RelightChoice found = with_entries(form, all_entries(form));
    if (!best || found.error < best->error ||
        (found.error == best->error && found.seconds < best->seconds)) {
      best = std::move(found);
    }
  }
  best->all_seconds = least_seconds_of_all(forms);
  best->is_within = false;
  return *best;
}

RelightChoice choose_within_seconds(std::span<const FormCost> forms, double seconds) {
  require_forms(forms);
  std::optional<RelightChoice> best;
  for (const FormCost& form : forms) {
    if (const auto entries = within_seconds(form, seconds)) {
      RelightChoice found = with_entries(form, *entries);
      if (!best || found.error < best->error ||
          (found.error == best->error && found.seconds < best->seconds)) {
        best = std::move(found);
      }
    }
  }
  if (best) {
    best->all_seconds = least_seconds_of_all(forms);
    return *best;
  }
  for (const FormCost& form : forms) {
    RelightChoice found =
        with_entries(form, std::vector<std::size_t>(form.seconds.size(), std::size_t{0}));
    if (!best || found.seconds < best->seconds) {
      best = std::move(found);
    }
  }
  best->all_seconds = least_seconds_of_all(forms);
  best->is_within = false;
  return *best;
}

RelightChoice choose_all(int n_lights) {
  RelightChoice choice;
  choice.terms = {n_lights};
  choice.is_predicted = false;
  return choice;
}

namespace {

std::string milliseconds(double seconds, std::size_t n_pictures) {
  return fmt::format("{:.1f} ms", 1e3 * seconds / static_cast<double>(n_pictures));
}

std::string reason(const RelightChoice& choice, const ChoiceWords& words) {
  const std::size_t n = choice.terms.size();
  if (words.seconds) {
    return choice.is_within && choice.has_all
               ? std::string("no better is in the file")
               : fmt::format("of {} allowed; all would take {}",
                             milliseconds(*words.seconds, 1),
                             milliseconds(choice.all_seconds, n));
  }
  if (words.is_exact) {
    return "an exact file's lights are all read, whatever the terms";
  }
  if (!choice.has_all) {
    return fmt::format("all {} would take {}", words.terms_all,
                       milliseconds(choice.all_seconds, n));
  }
  if (!choice.is_within || choice.fewest >= words.terms_all) {
    return fmt::format("fewer would not keep {:.3g}", *words.max_error);
  }
  return fmt::format(
      "{} would do, and save {}", choice.fewest,
      choice.fewest_seconds < 0.99 * choice.all_seconds
          ? fmt::format("too little ({})", milliseconds(choice.fewest_seconds, n))
          : std::string("nothing"));
}

}  // namespace

std::string words_of(const RelightChoice& choice, const ChoiceWords& words) {
  const std::size_t n = choice.terms.size();
  const int most = n == 0 ? 0 : *std::max_element(choice.terms.begin(), choice.terms.end());
  const std::string terms = words.is_exact   ? std::string("all lights")
                            : choice.has_all ? "all " + counted(words.terms_all, "term")
                            : n > 1          ? "at most " + counted(most, "term")
                                             : counted(most, "term");
  if (!choice.is_predicted) {
    return fmt::format("  {}: they cost less than to predict how many would do", terms);
  }
  const char* const from = choice.form == RelightForm::file     ? ""
                           : choice.form == RelightForm::memory ? ", held in memory"
                                                                : ", held as half floats";
  return fmt::format("  {}{}: {}{} predicted, {}", terms, from, milliseconds(choice.seconds, n),
                     n > 1 ? " per frame" : "", reason(choice, words));
}

}  // namespace haarlight::relight
