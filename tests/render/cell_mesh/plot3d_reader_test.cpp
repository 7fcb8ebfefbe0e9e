// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "tests/render/cell_mesh/broken_meshes.h"
#include "tests/render/cell_mesh/mesh_bytes.h"

namespace haarlight::render {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using Numbers = std::vector<double>;

struct Size {
  std::size_t i, j, k;
  [[nodiscard]] std::size_t n() const { return i * j * k; }
};

/// Writes grids of points at (i, 2 j, 3 k), the g-th one 10 g further along x.
struct Plot3dText {
  std::endian order = std::endian::big;
  bool has_marks = false;
  bool is_multiple = false;
  bool is_double = false;
  bool has_blanks = false;
  std::vector<Size> sizes = {{3, 3, 2}};
  bool is_left_handed = false;            ///< x the other way
  std::vector<std::size_t> blanked = {};  ///< points of iblank 0, others have 1 or -2
  std::size_t n_variables = 5;

  [[nodiscard]] std::string ints(const Numbers& values) const {
    return testing::bytes_of<std::int32_t>(values, order);
  }
  [[nodiscard]] std::string reals(const Numbers& values) const {
    return is_double ? testing::bytes_of<double>(values, order)
                     : testing::bytes_of<float>(values, order);
  }
  [[nodiscard]] std::string record(const std::string& bytes) const {
    const std::string mark = has_marks ? ints({static_cast<double>(bytes.size())}) : "";
    return mark + bytes + mark;
  }
  [[nodiscard]] std::string head() const {
    Numbers all;
    for (const Size& size : sizes) {
      for (const std::size_t n : {size.i, size.j, size.k}) {
        all.push_back(static_cast<double>(n));
      }
    }
    const std::string n_grids =
        is_multiple ? record(ints({static_cast<double>(sizes.size())})) : "";
    return n_grids + record(ints(all));
  }
  [[nodiscard]] std::string grid() const {
    std::string file = head();
    for (std::size_t g = 0; g < sizes.size(); ++g) {
      std::array<Numbers, 4> of;  // x, y, z, iblank
      for (std::size_t p = 0; p < sizes[g].n(); ++p) {
        const std::size_t along_k = sizes[g].i * sizes[g].j;
        const std::size_t j = p % along_k / sizes[g].i;
        const std::size_t k = p / along_k;
        of[0].push_back((is_left_handed ? -1.0 : 1.0) * static_cast<double>(p % sizes[g].i) +
                        10.0 * static_cast<double>(g));
        of[1].push_back(2.0 * static_cast<double>(j));
        of[2].push_back(3.0 * static_cast<double>(k));
        const bool is_blanked = std::find(blanked.begin(), blanked.end(), p) != blanked.end();
        of[3].push_back(is_blanked ? 0 : p % 2 == 0 ? 1 : -2);
      }
      file +=
          record(reals(of[0]) + reals(of[1]) + reals(of[2]) + (has_blanks ? ints(of[3]) : ""));
    }
    return file;
  }
  /// Variable v of point p: 100 v + p, over all grids.
  [[nodiscard]] std::string solution() const {
    std::string file = head();
    double first = 0;
    for (const Size& size : sizes) {
      file += record(reals({0.5, 1, 1000, 0.25}));
      std::string variables;
      for (std::size_t v = 0; v < n_variables; ++v) {
        Numbers values;
        for (std::size_t p = 0; p < size.n(); ++p) {
          values.push_back(100.0 * static_cast<double>(v) + first + static_cast<double>(p));
        }
        variables += reals(values);
      }
      file += record(variables);
      first += static_cast<double>(size.n());
    }
    return file;
  }
};

CellMesh parse(const std::string& grid, const std::optional<std::string>& solution) {
  return parse_plot3d(
      {.bytes = grid, .name = "t.xyz"},
      solution ? std::optional(NamedBytes{.bytes = *solution, .name = "t.q"}) : std::nullopt);
}

TEST(ReadPlot3d, RecognisesEveryLayout) {
  std::size_t n_read = 0;
  for (unsigned bits = 0; bits < 64; ++bits) {
    Plot3dText text;
    text.order = (bits & 1U) != 0 ? std::endian::big : std::endian::little;
    text.has_marks = (bits & 2U) != 0;
    text.is_double = (bits & 4U) != 0;
    text.has_blanks = (bits & 8U) != 0;
    text.is_multiple = (bits & 16U) != 0;
    const bool has_two = (bits & 32U) != 0;
    if (has_two && !text.is_multiple) {
      continue;
    }
    if (has_two) {
      text.sizes.push_back({2, 2, 3});
    }
    SCOPED_TRACE(bits);
    const CellMesh mesh = parse(text.grid(), text.solution());
    const std::size_t n = has_two ? 30 : 18;
    ASSERT_EQ(mesh.points.size(), n);
    EXPECT_EQ(mesh.points[16], Eigen::Vector3d(1, 4, 3));
    ASSERT_EQ(mesh.n_cells(), has_two ? 6U : 4U);
    EXPECT_THAT(mesh.nodes_of(3), ElementsAre(4, 5, 8, 7, 13, 14, 17, 16));
    if (has_two) {
      EXPECT_EQ(mesh.points[29], Eigen::Vector3d(11, 2, 6));
      EXPECT_THAT(mesh.nodes_of(5), ElementsAre(22, 23, 25, 24, 26, 27, 29, 28));
    }
    EXPECT_EQ(check_cell_mesh(mesh, "t").volume, has_two ? 36.0 : 24.0);
    EXPECT_EQ(mesh.n_turned + mesh.n_blanked + mesh.n_left_out, 0U);
    ASSERT_EQ(mesh.point_fields.size(), 3U);
    EXPECT_EQ(mesh.point_fields[0].name, "density");
    EXPECT_EQ(mesh.point_fields[1].name, "momentum");
    EXPECT_EQ(mesh.point_fields[2].name, "energy");
    ASSERT_EQ(mesh.point_fields[1].n_components, 3U);
    for (std::size_t p = 0; p < n; ++p) {
      const auto number = static_cast<double>(p);
      ASSERT_EQ(mesh.point_fields[0].values[p], number);
      for (std::size_t c = 0; c < 3; ++c) {
        ASSERT_EQ(mesh.point_fields[1].values[3 * p + c],
                  100.0 * static_cast<double>(c + 1) + number);
      }
      ASSERT_EQ(mesh.point_fields[2].values[p], 400.0 + number);
    }
    EXPECT_EQ(
        mesh.notes[0],
        fmt::format("t.xyz: {}-endian, {} record marks, {}3 x 3 x 2, {} precision{}",
                    (bits & 1U) != 0 ? "big" : "little", text.has_marks ? "with" : "without",
                    has_two            ? "a list of 2 grids, the first of "
                    : text.is_multiple ? "a list of 1 grid, the first of "
                                       : "one grid of ",
                    text.is_double ? "double" : "single", text.has_blanks ? ", iblank" : ""));
    EXPECT_EQ(mesh.notes.back(),
              "t.q: Mach 0.5, angle of attack 1, Reynolds number 1000, time 0.25");
    ++n_read;
  }
  EXPECT_EQ(n_read, 48U);
}

TEST(ReadPlot3d, GridAndSolutionMayBeWrittenInDifferentWays) {
  const Plot3dText grid;
  const Plot3dText solution{
      .order = std::endian::little, .has_marks = true, .is_multiple = true, .is_double = true};
  EXPECT_EQ(parse(grid.grid(), solution.solution()).point_fields[2].values[17], 417.0);
}

TEST(ReadPlot3d, ALeftHandedGridIsTurned) {
  const Plot3dText text{.sizes = {{3, 3, 2}}, .is_left_handed = true};
  const CellMesh mesh = parse(text.grid(), std::nullopt);
  EXPECT_EQ(mesh.n_turned, 4U);
  EXPECT_THAT(mesh.nodes_of(0), ElementsAre(9, 10, 13, 12, 0, 1, 4, 3));
  EXPECT_EQ(check_cell_mesh(mesh, "t").volume, 24.0);
}

TEST(ReadPlot3d, CellsWithABlankedCornerAreLeftOutAndCounted) {
  const Plot3dText text{.has_blanks = true, .sizes = {{3, 3, 2}}, .blanked = {9, 2}};
  const CellMesh mesh = parse(text.grid(), std::nullopt);
  EXPECT_EQ(mesh.n_blanked, 2U);
  EXPECT_THAT(mesh.numbers_in_file, ElementsAre(2, 3));
  EXPECT_THAT(mesh.nodes_of(0), ElementsAre(3, 4, 7, 6, 12, 13, 16, 15));
  EXPECT_EQ(mesh.points.size(), 18U);
}

TEST(ReadPlot3d, ZeroBytesBehindTheEndArePassedOverAndNoted) {
  const Plot3dText text;
  const CellMesh mesh =
      parse(text.grid() + std::string(5, '\0'), text.solution() + std::string(20, '\0'));
  EXPECT_EQ(mesh.n_cells(), 4U);
  EXPECT_THAT(mesh.notes, Contains("t.xyz: 5 zero bytes behind the end, from byte 228 on"));
  EXPECT_THAT(mesh.notes, Contains("t.q: 20 zero bytes behind the end, from byte 388 on"));
}

TEST(ReadPlot3d, BlanksThatAreAllZeroAreNoZeroBytesBehindTheEnd) {
  const Plot3dText text{
      .has_blanks = true, .sizes = {{2, 2, 2}}, .blanked = {0, 1, 2, 3, 4, 5, 6, 7}};
  const CellMesh mesh = parse(text.grid(), std::nullopt);
  EXPECT_EQ(mesh.n_blanked, 1U);
  EXPECT_EQ(mesh.n_cells(), 0U);
}

TEST(ReadPlot3d, RecordMarksGoBeforeASizeThatFitsByChance) {
  // The mark of the number of grids, that number and its mark read as a grid of 4 x 2 x 4: as
  // long in double precision as the two grids are.
  const Plot3dText text{.order = std::endian::little,
                        .has_marks = true,
                        .is_multiple = true,
                        .is_double = true,
                        .sizes = {{3, 3, 2}, {2, 2, 3}}};
  ASSERT_EQ(text.grid().size(), 12 + sizeof(double) * 4 * 2 * 4 * 3);
  EXPECT_EQ(parse(text.grid(), std::nullopt).n_cells(), 6U);
}

TEST(ReadPlot3d, ReadsTheExampleOfTheDocuments) {
  const std::string folder = std::string(HAARLIGHT_SOURCE_DIR) + "/configs/volumes/";
  const CellMesh mesh =
      read_cell_mesh(folder + "duct.xyz", {.format = {}, .solution = folder + "duct.q"});
  EXPECT_EQ(mesh.n_cells(), 54U);
  EXPECT_EQ(mesh.n_turned, 54U);
  EXPECT_EQ(mesh.point_fields.size(), 3U);
  // A quarter of a ring of radii 1 and 2, of height 1, with its arcs as six chords of 15 degrees:
  // 3/2 of 6 sin 15 deg; the coordinates have single precision.
  EXPECT_NEAR(check_cell_mesh(mesh, "t").volume, 9.0 * 0.25881904510252, 1e-6);
}

TEST(ReadCellMesh, ASolutionBelongsToAPlot3dGrid) {
  const std::string folder = std::string(HAARLIGHT_SOURCE_DIR) + "/configs/volumes/";
  try {
    static_cast<void>(read_cell_mesh(folder + "four_cells.vtu",
                                     {.format = {}, .solution = folder + "duct.q"}));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("a solution beside a mesh of format vtu"));
    EXPECT_THAT(error.where(), HasSubstr("duct.q"));
  }
  EXPECT_THROW(static_cast<void>(read_cell_mesh(folder + "duct.xyz",
                                                {.format = {}, .solution = "/nowhere/a.q"})),
               Error);
  EXPECT_THROW(static_cast<void>(read_cell_mesh(folder + "duct.q")), Error);  // its ending
}

struct Broken {
  std::string grid;
  std::optional<std::string> solution;
  std::string where;  ///< all of it
  std::string what;   ///< a part
};

std::string cut(const std::string& bytes, std::size_t n) {
  return bytes.substr(0, bytes.size() - n);
}

std::string with_byte(std::string bytes, std::size_t at, char byte) {
  bytes.at(at) = byte;
  return bytes;
}

std::vector<Broken> broken_grids() {
  const Plot3dText plain;
  const Plot3dText marked{.has_marks = true};
  const Plot3dText several{
      .has_marks = true, .is_multiple = true, .sizes = {{3, 3, 2}, {2, 2, 3}}};
  const std::string good = plain.grid();
  const std::string records = marked.grid();
  const std::string zeros(76, '\0');
  return {
      {"", {}, "t.xyz: byte 0", "the first numbers of the grid are no sizes of grids"},
      {good.substr(0, 11), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {std::string(300, '\0'), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {std::string(300, '\xff'), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {"  3 3 2\n0.0 1.0e0 2.0 0.0", {}, "t.xyz: byte 0", "a grid as text (formatted)"},
      {"<VTKFile type=\"UnstructuredGrid\">", {}, "t.xyz: byte 0", "are no sizes of grids"},
      {with_byte(good, 3, '\0'), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {with_byte(good, 0, '\x7f'), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {with_byte(good, 3, '\4'), {}, "t.xyz: byte 228", "one grid of 4 x 3 x 2: 300 bytes"},
      {cut(good, 1),
       {},
       "t.xyz: byte 227",
       "the grid's 227 bytes fit no layout; tried were big-endian, without record marks, one "
       "grid of 3 x 3 x 2: 228 bytes (single precision), 300 bytes (single precision, iblank), "
       "444 bytes (double precision), 516 bytes (double precision, iblank)"},
      {good.substr(0, 12), {}, "t.xyz: byte 12", "the grid's 12 bytes fit no layout"},
      {good + "\1", {}, "t.xyz: byte 229", "the grid's 229 bytes fit no layout"},
      {good + zeros, {}, "t.xyz: byte 0", "single precision, iblank': 304 bytes fit both"},
      {cut(Plot3dText{.is_double = true}.grid(), 8), {}, "t.xyz: byte 436", "436 bytes"},
      {cut(several.grid(), 4), {}, "t.xyz: byte 416", "a list of 2 grids, the first of"},
      {with_byte(several.grid(), 7, '\3'),
       {},
       "t.xyz: byte 420",
       "the grid's 420 bytes fit no"},
      {with_byte(records, 0, '\1'), {}, "t.xyz: byte 0", "are no sizes of grids"},
      {with_byte(records, 19, '\13'), {}, "t.xyz: byte 244", "the grid's 244 bytes fit no"},
      {with_byte(records, 22, '\3'),
       {},
       "t.xyz: byte 20",
       "no record mark of 216 bytes, where a record begins or ends"},
      {with_byte(records, records.size() - 1, '\0'),
       {},
       "t.xyz: byte 240",
       "no record mark of 216 bytes"},
      {Plot3dText{.sizes = {{9, 4, 1}}}.grid(),
       {},
       "t.xyz: byte 0",
       "no volume: big-endian, without record marks, one grid of 9 x 4 x 1"},
      {testing::bytes_of<std::int32_t>(Numbers{5000000, 5000000, 5000000}, std::endian::big),
       {},
       "t.xyz: byte 0",
       "are no sizes of grids"},
      {testing::bytes_of<std::int32_t>(Numbers{1000, 1000, 4000}, std::endian::big),
       {},
       "t.xyz: byte 12",
       "one grid of 1000 x 1000 x 4000: 48000000012 bytes"},
  };
}

std::vector<Broken> broken_solutions() {
  const Plot3dText plain;
  const Plot3dText marked{.has_marks = true};
  const Plot3dText longer{.sizes = {{3, 2, 3}}};
  const Plot3dText twice{.is_multiple = true, .sizes = {{3, 3, 2}, {3, 3, 2}}};
  const Plot3dText six{.sizes = {{3, 3, 2}}, .n_variables = 6};
  const std::string grid = plain.grid();
  const std::string good = plain.solution();
  const std::string records = marked.solution();
  return {
      {grid, "", "t.q: byte 0", "the first numbers of the solution are no sizes"},
      {grid, "3 3 2 0.5 1", "t.q: byte 0", "a solution as text (formatted)"},
      {grid, cut(good, 4), "t.q: byte 384", "the solution's 384 bytes fit no layout"},
      {grid, good + "\1", "t.q: byte 389", "388 bytes (single precision), 764 bytes (double"},
      {grid, grid, "t.q: byte 228", "the solution's 228 bytes fit no layout"},
      {good, good, "t.xyz: byte 388", "the grid's 388 bytes fit no layout"},
      {grid, six.solution(), "t.q: byte 460", "the solution's 460 bytes fit no layout"},
      {grid, longer.solution(), "t.q: byte 0",
       "a solution of another grid: big-endian, without record marks, one grid of 3 x 2 x 3"},
      {grid, twice.solution(), "t.q: byte 0", "a list of 2 grids, the first of 3 x 3 x 2"},
      {grid, with_byte(records, 23, '\x11'), "t.q: byte 20", "no record mark of 16 bytes"},
      {grid, with_byte(records, 47, '\x11'), "t.q: byte 44", "no record mark of 360 bytes"},
      {grid, with_byte(records, 410, '\x11'), "t.q: byte 408", "no record mark of 360 bytes"},
  };
}

TEST(ReadPlot3d, RefusesBrokenFilesByPlaceAndCause) {
  const std::size_t n_broken = test::expect_refused<Broken>(
      {broken_grids(), broken_solutions()},
      [](const Broken& item) { static_cast<void>(parse(item.grid, item.solution)); });
  EXPECT_GE(n_broken, 35U);
}

}  // namespace
}  // namespace haarlight::render
