// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>

/// @file
/// Every algorithm at every kind of extreme: a test each, whose outcome is a cell of
/// docs/numerics/extremes.md. A module's rows and cells stand in tests/ROOM/MODULE_extremes.cpp:
///
///     EXTREMES_OF(haar, "relight/basis: Haar", "Haar transform, n x n")
///     EXTREME(haar, dark) { ...; return exact("all coefficients are 0"); }
///     NO_EXTREME(haar, grazing, "it knows no geometry");
///
/// extremes_page_test.cpp compares the page with all cells and fails where a row lacks one. A
/// cell's text is what the test asserts (a bound, a message), never a measured figure: it is the
/// same on every machine and in every build.

namespace haarlight::extremes {

/// The columns, in the page's order; words and meaning: extremes.cpp.
enum class Kind {
  dark,
  one,
  largest,
  odd_size,
  scale,
  subnormal,
  not_finite,
  degenerate,
  grazing,
  far_near,
  duplicate,
  clipped,
};
inline constexpr int kKinds = 12;

/// How an algorithm ends at an extreme.
enum class Outcome {
  exact,           ///< the true result
  bounded,         ///< within a stated error
  stated,          ///< something is missing, and the result says what
  refused,         ///< an error that names the cause
  does_not_apply,  ///< no such extreme exists; the text says why
};

struct Cell {
  Outcome outcome = Outcome::exact;
  std::string text;
};

[[nodiscard]] Cell exact(std::string text);
[[nodiscard]] Cell stated(std::string text);
/// Fails the test unless `error` is at most `bound`; NaN fails.
/// @param of   what error: "relative error", "mm"
/// @param why  where the bound comes from
[[nodiscard]] Cell bounded(double error, double bound, std::string_view of,
                           std::string_view why);
/// Fails the test unless `call` throws an Error whose text contains `fragment`, or, where
/// `fragment` is that of a precondition, a ContractViolation. The cell is the message, without
/// file and position.
[[nodiscard]] Cell refused(std::string_view fragment, const std::function<void()>& call);

/// Two outcomes of one cell, the first one's sign in the overview.
[[nodiscard]] Cell both(const Cell& first, const Cell& second);

/// One row.
struct Row {
  std::string_view module;  ///< folder of the sources
  std::string_view name;
  std::string_view id;
};

/// Registers a cell and its GoogleTest test `Extremes_ID.KIND`; returns 0.
int add_cell(const Row& row, Kind kind, Cell (*cell)());

/// The whole page; runs the cells that have not run yet. Names every cell that is missing.
struct Page {
  std::string text;
  std::string missing;  ///< a line per missing or empty cell
};
[[nodiscard]] Page make_page();

}  // namespace haarlight::extremes

#define EXTREMES_OF(id, module, name) \
  ::haarlight::extremes::Row id##_row() { return {module, name, #id}; }

#define EXTREME(id, kind)                                                     \
  ::haarlight::extremes::Cell id##_##kind();                                  \
  [[maybe_unused]] int id##_##kind##_added = ::haarlight::extremes::add_cell( \
      id##_row(), ::haarlight::extremes::Kind::kind, id##_##kind);            \
  ::haarlight::extremes::Cell id##_##kind()

#define NO_EXTREME(id, kind, why) \
  EXTREME(id, kind) { return {::haarlight::extremes::Outcome::does_not_apply, why}; }

/// The kinds that only geometry has.
#define NO_GEOMETRY(id)                              \
  NO_EXTREME(id, degenerate, "it knows no geometry") \
  NO_EXTREME(id, grazing, "it knows no geometry")    \
  NO_EXTREME(id, far_near, "it knows no geometry")
