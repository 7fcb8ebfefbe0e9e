// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_choice.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

/// Seconds that ascend and errors that descend, as the real ones do, in random steps.
FormCost random_form(RelightForm form, std::uint64_t seed, std::size_t n_pictures,
                     std::size_t n_terms) {
  FormCost cost;
  cost.form = form;
  cost.least_terms = static_cast<int>(seed % 2);
  cost.prepare = uniform_unit(hash_key(seed, 1));
  for (std::size_t e = 0; e < n_pictures; ++e) {
    std::vector<double>& seconds = cost.seconds.emplace_back();
    std::vector<double>& errors = cost.errors.emplace_back();
    double spent = 0.0;
    double error = 1.0;
    for (std::size_t k = 0; k < n_terms; ++k) {
      const double step = uniform_unit(hash_key(seed, 2, e, k));
      spent += step < 0.2 ? 1.0 : 0.01 * step;  // a group of coefficients; a term's products
      error *= 1.0 - 0.5 * uniform_unit(hash_key(seed, 3, e, k));
      seconds.push_back(spent);
      errors.push_back(error);
    }
  }
  return cost;
}

std::vector<FormCost> random_forms(std::uint64_t seed) {
  const std::size_t n_pictures = 1 + seed % 3;
  const std::size_t n_terms = 1 + hash_key(seed, 9) % 12;
  std::vector<FormCost> forms{random_form(RelightForm::file, seed, n_pictures, n_terms)};
  if (seed % 4 != 0) {
    forms.push_back(random_form(RelightForm::memory, seed + 1000, n_pictures, n_terms));
  }
  return forms;
}

double seconds_of(const FormCost& form, const std::vector<std::size_t>& entries) {
  double seconds = form.prepare;
  for (std::size_t e = 0; e < entries.size(); ++e) {
    seconds += form.seconds[e][entries[e]];
  }
  return seconds;
}

double error_of(const FormCost& form, const std::vector<std::size_t>& entries) {
  double error = 0.0;
  for (std::size_t e = 0; e < entries.size(); ++e) {
    error = std::max(error, form.errors[e][entries[e]]);
  }
  return error;
}

/// Calls `use` with every number of terms of every picture.
template <class Use>
void for_all_entries(const FormCost& form, const Use& use) {
  const std::size_t n_terms = form.seconds[0].size();
  std::vector<std::size_t> entries(form.seconds.size());
  while (true) {
    use(entries);
    std::size_t e = 0;
    while (e < entries.size() && ++entries[e] == n_terms) {
      entries[e++] = 0;
    }
    if (e == entries.size()) {
      return;
    }
  }
}

TEST(RelightChoice, OfAnErrorIsWhatTryingEveryNumberOfTermsFinds) {
  int n_all = 0;
  int n_fewer = 0;
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    const std::vector<FormCost> forms = random_forms(seed);
    const double requested = std::pow(0.1, 3.0 * uniform_unit(hash_key(seed, 7)));
    double least = std::numeric_limits<double>::infinity();
    for (const FormCost& form : forms) {
      const std::vector<std::size_t> all(form.seconds.size(), form.seconds[0].size() - 1);
      const double of_all = seconds_of(form, all);
      for_all_entries(form, [&](const std::vector<std::size_t>& entries) {
        if (error_of(form, entries) <= requested) {
          const double again = entries == all ? 0.0 : kSecondSums * (of_all - form.prepare);
          least = std::min(least, seconds_of(form, entries) + again);
        }
      });
    }
    const RelightChoice choice = choose_within_error(forms, requested);
    EXPECT_EQ(choice.is_within, std::isfinite(least)) << seed;
    if (!choice.is_within) {
      EXPECT_TRUE(choice.has_all) << seed;
      continue;
    }
    EXPECT_LE(choice.error, requested) << seed;
    const FormCost& form = *std::ranges::find(forms, choice.form, &FormCost::form);
    std::vector<std::size_t> entries;
    for (const int terms : choice.terms) {
      entries.push_back(static_cast<std::size_t>(terms - form.least_terms));
    }
    const std::vector<std::size_t> all(entries.size(), form.seconds[0].size() - 1);
    const double again =
        choice.has_all ? 0.0 : kSecondSums * (seconds_of(form, all) - form.prepare);
    EXPECT_NEAR(choice.seconds + again, least, 1e-12 * least) << seed;
    EXPECT_DOUBLE_EQ(choice.seconds, seconds_of(form, entries)) << seed;
    EXPECT_DOUBLE_EQ(choice.error, error_of(form, entries)) << seed;
    (choice.has_all ? n_all : n_fewer) += 1;
  }
  EXPECT_GT(n_all, 20);
  EXPECT_GT(n_fewer, 40);
}

TEST(RelightChoice, OfATimeIsWhatTryingEveryNumberOfTermsFinds) {
  int n_short = 0;
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    const std::vector<FormCost> forms = random_forms(seed);
    const double allowed = 4.0 * uniform_unit(hash_key(seed, 8));
    double least_error = std::numeric_limits<double>::infinity();
    double least_seconds = std::numeric_limits<double>::infinity();
    for (const FormCost& form : forms) {
      const double each = form.prepare / static_cast<double>(form.seconds.size());
      for_all_entries(form, [&](const std::vector<std::size_t>& entries) {
        bool is_allowed = true;  // every picture in its own time
        for (std::size_t e = 0; e < entries.size(); ++e) {
          is_allowed = is_allowed && form.seconds[e][entries[e]] <= allowed - each;
        }
        least_seconds = std::min(least_seconds, seconds_of(form, entries));
        if (is_allowed) {
          least_error = std::min(least_error, error_of(form, entries));
        }
      });
    }
    const RelightChoice choice = choose_within_seconds(forms, allowed);
    EXPECT_EQ(choice.is_within, std::isfinite(least_error)) << seed;
    if (choice.is_within) {
      EXPECT_DOUBLE_EQ(choice.error, least_error) << seed;
      EXPECT_LE(choice.seconds,
                allowed * static_cast<double>(choice.terms.size()) * (1.0 + 1e-12));
    } else {
      EXPECT_DOUBLE_EQ(choice.seconds, least_seconds) << seed;
      ++n_short;
    }
  }
  EXPECT_GT(n_short, 20);
  EXPECT_LT(n_short, 200);
}

TEST(RelightChoice, MoreTimeNeverMeansALargerError) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const std::vector<FormCost> forms = random_forms(seed);
    double before = std::numeric_limits<double>::infinity();
    for (double allowed = 0.0; allowed < 12.0; allowed += 0.25) {
      const RelightChoice choice = choose_within_seconds(forms, allowed);
      if (choice.is_within) {
        EXPECT_LE(choice.error, before) << seed << " " << allowed;
        before = choice.error;
      }
    }
  }
}

TEST(RelightChoice, SaysWhatItChoseAndWhy) {
  FormCost cost;
  cost.seconds = {{0.001, 0.0695, 0.07}};
  cost.errors = {{1.0, 0.02, 0.01}};
  const std::vector<FormCost> forms{cost};
  const auto words = [&](double max_error) {
    return words_of(choose_within_error(forms, max_error),
                    {.max_error = max_error, .seconds = {}, .terms_all = 2});
  };
  EXPECT_EQ(words(0.05), "  all 2 terms: 70.0 ms predicted, 1 would do, and save nothing");
  EXPECT_EQ(words(0.01), "  all 2 terms: 70.0 ms predicted, fewer would not keep 0.01");
  EXPECT_EQ(words(0.001), "  all 2 terms: 70.0 ms predicted, fewer would not keep 0.001");
  EXPECT_EQ(words(1.0), "  0 terms: 1.0 ms predicted, all 2 would take 70.0 ms");
  EXPECT_EQ(words_of(choose_within_seconds(forms, 0.0696),
                     {.max_error = {}, .seconds = 0.0696, .terms_all = 2}),
            "  1 term: 69.5 ms predicted, of 69.6 ms allowed; all would take 70.0 ms");
  EXPECT_EQ(words_of(choose_within_seconds(forms, 1.0),
                     {.max_error = {}, .seconds = 1.0, .terms_all = 2}),
            "  all 2 terms: 70.0 ms predicted, no better is in the file");
}

TEST(RelightChoice, OfAllTermsWithoutAPredictionItSaysThat) {
  const RelightChoice all = choose_all(64);
  EXPECT_EQ(all.terms, std::vector<int>{64});
  EXPECT_TRUE(all.has_all);
  EXPECT_FALSE(all.is_predicted);
  EXPECT_EQ(words_of(all, {.max_error = 0.1, .seconds = {}, .terms_all = 64}),
            "  all 64 terms: they cost less than to predict how many would do");
}

TEST(RelightChoice, WantsFormsOfTheSamePictures) {
  EXPECT_THROW((void)choose_within_error({}, 0.1), ContractViolation);
  const std::vector<FormCost> forms{random_form(RelightForm::file, 1, 2, 3),
                                    random_form(RelightForm::memory, 2, 1, 3)};
  EXPECT_THROW((void)choose_within_seconds(forms, 1.0), ContractViolation);
}

}  // namespace
}  // namespace haarlight::relight
