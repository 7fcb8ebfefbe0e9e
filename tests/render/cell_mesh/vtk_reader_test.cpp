// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "tests/render/cell_mesh/broken_meshes.h"
#include "tests/render/cell_mesh/mesh_bytes.h"

namespace haarlight::render {
namespace {

using ::testing::ElementsAreArray;
using testing::FourCells;
using testing::replaced;

/// FourCells in the legacy format.
class VtkText {
 public:
  VtkText(int major, bool is_binary) : major_(major), is_binary_(is_binary) {}

  template <class T>
  [[nodiscard]] std::string numbers(const std::vector<double>& values) const {
    return is_binary_ ? testing::bytes_of<T>(values, std::endian::big) + "\n"
                      : fmt::format("{}\n", fmt::join(values, " "));
  }

  [[nodiscard]] std::string file(const FourCells& four) const {
    std::string text = fmt::format(
        "# vtk DataFile Version {}.{}\nfour cells\n{}\nDATASET UNSTRUCTURED_GRID\n"
        "FIELD FieldData 1\ntime 1 1 double\n{}POINTS {} double\n{}",
        major_, major_ == 5 ? 1 : 0, is_binary_ ? "BINARY" : "ASCII", numbers<double>({0.5}),
        four.points.size() / 3, numbers<double>(four.points));
    text += "METADATA\nINFORMATION 0\n\n" + cells(four);
    text +=
        fmt::format("CELL_TYPES {}\n{}", four.types.size(), numbers<std::int32_t>(four.types));
    text += fmt::format("POINT_DATA {}\nSCALARS height double\nLOOKUP_TABLE of_mine\n{}",
                        four.height.size(), numbers<double>(four.height));
    const std::vector<double> colours(8, 1.0);
    text += "LOOKUP_TABLE of_mine 2\n" +
            (is_binary_ ? numbers<std::uint8_t>(colours) : numbers<float>(colours));
    text += "VECTORS position float\n" + numbers<float>(four.points);
    text +=
        fmt::format("CELL_DATA {}\nFIELD FieldData 2\nmaterial%20no. 1 4 unsigned_short\n{}",
                    four.types.size(), numbers<std::uint16_t>(four.material));
    return text + "pair 2 4 int\n" + numbers<std::int32_t>({1, 2, 3, 4, 5, 6, 7, 8});
  }

 private:
  [[nodiscard]] std::string cells(const FourCells& four) const {
    if (major_ == 5) {
      std::vector<double> offsets = four.ends;
      offsets.insert(offsets.begin(), 0.0);
      return fmt::format("CELLS {} {}\nOFFSETS vtktypeint64\n{}CONNECTIVITY vtktypeint64\n{}",
                         offsets.size(), four.nodes.size(), numbers<std::int64_t>(offsets),
                         numbers<std::int64_t>(four.nodes));
    }
    std::vector<double> counted;
    double begin = 0.0;
    for (const double end : four.ends) {
      counted.push_back(end - begin);
      for (; begin < end; ++begin) {
        counted.push_back(four.nodes[static_cast<std::size_t>(begin)]);
      }
    }
    return fmt::format("CELLS {} {}\n{}", four.ends.size(), counted.size(),
                       numbers<std::int32_t>(counted));
  }

  int major_;
  bool is_binary_;
};

TEST(ReadVtk, ReadsTheSameFromEveryVersionAndCoding) {
  const FourCells four;
  for (const int major : {1, 2, 3, 4, 5}) {
    for (const bool is_binary : {false, true}) {
      SCOPED_TRACE(fmt::format("version {}, binary {}", major, is_binary));
      const CellMesh mesh = parse_vtk(VtkText(major, is_binary).file(four), "t.vtk");
      ASSERT_EQ(mesh.points.size(), 12U);
      EXPECT_EQ(mesh.points[8], Eigen::Vector3d(0.5, 0.5, 1.5));
      EXPECT_EQ(mesh.points[11], Eigen::Vector3d(1.25, -1, 0.25));
      EXPECT_THAT(mesh.types, ElementsAreArray({CellType::hexahedron, CellType::pyramid,
                                                CellType::wedge, CellType::tetrahedron}));
      EXPECT_THAT(mesh.nodes, ElementsAreArray(four.nodes_read()));
      ASSERT_EQ(mesh.point_fields.size(), 2U);
      EXPECT_EQ(mesh.point_fields[0].name, "height");
      EXPECT_EQ(mesh.point_fields[0].values, four.height);
      EXPECT_EQ(mesh.point_fields[1].n_components, 3U);
      EXPECT_EQ(mesh.point_fields[1].values, four.points);
      ASSERT_EQ(mesh.cell_fields.size(), 2U);
      EXPECT_EQ(mesh.cell_fields[0].name, "material no.");
      EXPECT_EQ(mesh.cell_fields[0].values, four.material);
      EXPECT_THAT(mesh.cell_fields[1].values, ElementsAreArray({1, 2, 3, 4, 5, 6, 7, 8}));
    }
  }
}

TEST(ReadVtk, TakesLinesThatEndAsOnWindows) {
  std::string text = VtkText(3, false).file(FourCells());
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += 2) {
    text.insert(at, "\r");
  }
  EXPECT_THAT(parse_vtk(text, "t.vtk").nodes, ElementsAreArray(FourCells().nodes_read()));
}

TEST(ReadVtk, TakesNumbersAsOtherProgramsWriteThem) {
  std::string text = VtkText(3, false).file(FourCells());
  text = replaced(text, "0 0 0 0 1 1 1 1 1.5 0 0 0.25",
                  "+0 -0 1e-400 0 1. 1E0 10e-1 .1e1 nan -inf 0 +.25");
  const std::vector<double> values = parse_vtk(text, "t.vtk").point_fields[0].values;
  EXPECT_THAT(std::vector<double>(values.begin(), values.begin() + 8),
              ElementsAreArray({0, 0, 0, 0, 1, 1, 1, 1}));
  EXPECT_TRUE(std::isnan(values[8]));
  EXPECT_EQ(values[9], -std::numeric_limits<double>::infinity());
  EXPECT_EQ(values[11], 0.25);
}

struct Broken {
  std::string bytes;
  std::string where;  ///< all of it
  std::string what;   ///< a part
};

std::vector<Broken> broken_ascii() {
  const std::string good = VtkText(3, false).file(FourCells());
  const auto with = [](auto change) {
    FourCells four;
    change(four);
    return VtkText(3, false).file(four);
  };
  return {
      {"", "t.vtk:1", "not a legacy VTK file"},
      {"<VTKFile/>", "t.vtk:1", "not a legacy VTK file"},
      {replaced(good, "Version 3.0", "Version 6.0"), "t.vtk:1", "version '6.0' is not read"},
      {replaced(good, "Version 3.0", "Version x"), "t.vtk:1", "version 'x' is not read"},
      {replaced(good, "ASCII", "EBCDIC"), "t.vtk:3", "'ebcdic' instead of ASCII or BINARY"},
      {replaced(good, "DATASET UNSTRUCTURED_GRID", "POINTS 3 float"), "t.vtk:4", "no DATASET"},
      {replaced(good, "UNSTRUCTURED_GRID", "POLYDATA"), "t.vtk:4",
       "a dataset of type POLYDATA"},
      {"# vtk DataFile Version 3.0\n\nASCII\n", "t.vtk:4", "the file ends before DATASET"},
      {replaced(good, "POINTS 12 double", "POINTS twelve double"), "t.vtk:8",
       "without its numbers"},
      {replaced(good, "POINTS 12 double", "POINTS 12 quadruple"), "t.vtk:8", "unknown type"},
      {replaced(good, "POINTS 12 double", "POINTS 6148914691236517206 double"), "t.vtk:8",
       "6148914691236517206 times 3 numbers in the"},
      {replaced(good, "POINTS 12 double", "POINTS 13 double"), "t.vtk:10", "not a number"},
      {replaced(good, "POINTS 12 double", "POINTS 11 double"), "t.vtk:9",
       "'1.25' is not understood here"},
      {good.substr(0, good.find("CELL_TYPES")), "t.vtk:15", "no CELL_TYPES before the end"},
      {good.substr(0, good.find("CELLS")), "t.vtk:13", "no CELLS before the end"},
      {good.substr(0, good.find("POINTS")), "t.vtk:8", "no POINTS before the end"},
      {good.substr(0, good.find("pair") + 15), "t.vtk:29", "times 2 numbers in the"},
      {replaced(good, "CELLS 4 27", "CELLS 4 26"), "t.vtk:13", "cell 3 of 4 nodes, where 3"},
      {replaced(good, "CELLS 4 27", "CELLS 3 27"), "t.vtk:13",
       "5 numbers of CELLS belong to no"},
      {replaced(good, "CELLS 4 27", "CELLS 5 27"), "t.vtk:13", "CELLS end within cell 4 of 5"},
      {replaced(good, "\n8 0 1", "\n-8 0 1"), "t.vtk:13", "cell 0 of -8 nodes"},
      {replaced(good, "CELL_TYPES 4\n12 14 13 10", "CELL_TYPES 3\n12 14 13"), "t.vtk:13",
       "3 CELL_TYPES for 4 CELLS"},
      {replaced(good, "POINT_DATA 12", "POINTS 1 float\n0 0 0\nPOINT_DATA 12"), "t.vtk:17",
       "POINTS for the second time"},
      {replaced(good, "VECTORS position float", "SPINORS position float"), "t.vtk:23",
       "'SPINORS' is not understood"},
      {replaced(good, "POINT_DATA 12\n", ""), "t.vtk:17", "'SCALARS' is not understood here"},
      {replaced(good, "pair 2 4 int", "pair 0 4 int"), "t.vtk:29", "4 times 0 numbers"},
      {replaced(good, "pair 2 4 int", "pair 4 2 int"), "t.vtk",
       "'pair' has 2 items for 4 cells"},
      {replaced(good, "pair 2 4 int", "pair 2"), "t.vtk:29", "without its numbers"},
      {replaced(good, "FieldData 2", "FieldData 3"), "t.vtk:31",
       "the file ends before array 2 of 3"},
      {with([](FourCells& f) { f.nodes[22] = 12; }), "t.vtk:13", "cell 3 names point 12 of 12"},
      {with([](FourCells& f) { f.types[0] = 32; }), "t.vtk:13",
       "cell 0 is a quadratic wedge of 18 nodes"},
      {with([](FourCells& f) { f.types[3] = 12; }), "t.vtk:13",
       "cell 3 is a hexahedron of 4 nodes instead of 8"},
  };
}

std::vector<Broken> broken_binary() {
  const std::string good = VtkText(2, true).file(FourCells());
  const std::string five = VtkText(5, true).file(FourCells());
  const auto at = [](const std::string& text, std::string_view word) {
    return fmt::format("t.vtk: byte {}", text.find(word));
  };
  return {
      {good.substr(0, good.find("CELLS") + 40), at(good, "CELLS"), "27 times 1 numbers in the"},
      {replaced(good, "POINTS 12 double", "POINTS 13 double"), "t.vtk",
       "'height' has 12 items for 13 points"},
      {replaced(good.substr(0, good.find("CELLS")), "POINTS 12 double", "POINTS 14 double"),
       at(good, "POINTS"), "14 times 3 numbers in the"},
      {replaced(five, "OFFSETS", "ONSETS"), at(five, "OFFSETS"), "'ONSETS' instead of OFFSETS"},
      {replaced(five, "CONNECTIVITY", "NODES"), at(five, "CONNECTIVITY"),
       "'NODES' instead of CONNECTIVITY"},
      {replaced(five, "vtktypeint64", "vtktypeint9"), at(five, "OFFSETS"), "unknown type"},
      {replaced(five, std::string("int64\n\0", 7), "int64\n\1"), at(five, "CONNECTIVITY"),
       "OFFSETS begin at"},
  };
}

TEST(ReadVtk, RefusesBrokenFilesByPlaceAndCause) {
  const std::size_t n_broken = test::expect_refused<Broken>(
      {broken_ascii(), broken_binary()},
      [](const Broken& item) { static_cast<void>(parse_vtk(item.bytes, "t.vtk")); });
  EXPECT_GE(n_broken, 35U);
}

TEST(ReadCellMesh, ChoosesByTheEnding) {
  EXPECT_EQ(mesh_format("a/b.vtu"), MeshFormat::vtu);
  EXPECT_EQ(mesh_format("b.vtk"), MeshFormat::vtk);
  EXPECT_EQ(mesh_format("b.msh"), MeshFormat::msh);
  for (const std::string ending : {"xyz", "x", "g", "p3d"}) {
    EXPECT_EQ(mesh_format("b." + ending), MeshFormat::plot3d);
  }
  EXPECT_THROW(static_cast<void>(mesh_format("b.obj")), Error);
  EXPECT_THROW(static_cast<void>(read_cell_mesh("/nowhere/a.vtu")), Error);
}

}  // namespace
}  // namespace haarlight::render
