// SPDX-License-Identifier: Apache-2.0
#include <cmath>

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
using Numbers = std::vector<double>;

/// FourCells in gmsh's format 4.1: nodes with gaps between their tags, in two blocks, one of
/// them parametric; two triangles before the cells.
class MshText {
 public:
  explicit MshText(bool is_binary, std::endian order = std::endian::little,
                   std::size_t size_bytes = 8)
      : is_binary_(is_binary), order_(order), size_bytes_(size_bytes) {}

  [[nodiscard]] std::string sizes(const Numbers& values) const {
    if (!is_binary_) {
      return text(values);
    }
    return size_bytes_ == 8 ? testing::bytes_of<std::uint64_t>(values, order_)
                            : testing::bytes_of<std::uint32_t>(values, order_);
  }
  [[nodiscard]] std::string ints(const Numbers& values) const {
    return is_binary_ ? testing::bytes_of<std::int32_t>(values, order_) : text(values);
  }
  [[nodiscard]] std::string reals(const Numbers& values) const {
    return is_binary_ ? testing::bytes_of<double>(values, order_) : text(values);
  }
  [[nodiscard]] std::string end(std::string_view section) const {
    return fmt::format("{}$End{}\n", is_binary_ ? "\n" : "", section);
  }

  [[nodiscard]] std::string head() const {
    return fmt::format("$MeshFormat\n4.1 {} {}\n", is_binary_ ? 1 : 0, size_bytes_) +
           (is_binary_ ? ints({1}) : "") + end("MeshFormat");
  }
  static double tag_of(double node) { return 1000 - 7 * node; }

  [[nodiscard]] std::string nodes(const FourCells& four) const {
    std::string nodes = "$Nodes\n" + sizes({3, 12, 2, 1000}) + ints({3, 1, 0}) + sizes({8});
    for (std::size_t i = 0; i < 12; ++i) {
      nodes += i == 8 ? "" : sizes({tag_of(static_cast<double>(i))});
      if (i == 7) {
        nodes += reals({four.points.begin(), four.points.begin() + 24});
        nodes += ints({0, 5, 0}) + sizes({1});
        nodes += sizes({tag_of(8)}) + reals({0.5, 0.5, 1.5});
        nodes += ints({2, 1, 1}) + sizes({3});
      }
    }
    for (std::size_t i = 9; i < 12; ++i) {
      nodes += reals({four.points[3 * i], four.points[3 * i + 1], four.points[3 * i + 2]});
      nodes += reals({0.25, 0.75});  // its position on the surface
    }
    return nodes + end("Nodes");
  }

  /// @param of  the cells' nodes, in gmsh's order
  [[nodiscard]] std::string elements(const Numbers& of, const Numbers& types) const {
    std::string elements = "$Elements\n" + sizes({5, 6, 1, 90}) + ints({2, 1, 2}) + sizes({2});
    elements += sizes({1, tag_of(0), tag_of(1), tag_of(2)});
    elements += sizes({2, tag_of(0), tag_of(2), tag_of(3)});
    const Numbers counts = {8, 5, 6, 4};
    std::size_t at = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      elements += ints({3, 1, types[i]}) + sizes({1});
      elements += sizes({60 + 10 * static_cast<double>(i)});
      for (double k = 0; k < counts[i]; ++k, ++at) {
        elements += sizes({tag_of(of[at])});
      }
    }
    return elements + end("Elements");
  }

  /// A section of values.
  [[nodiscard]] std::string data(std::string_view section, std::string_view name, double step,
                                 std::size_t n_components, const Numbers& tags,
                                 const Numbers& values) const {
    std::string data = fmt::format("${}\n1\n\"{}\"\n1\n0.5\n3\n{}\n{}\n{}\n", section, name,
                                   step, n_components, tags.size());
    for (std::size_t i = 0; i < tags.size(); ++i) {
      data += ints({tags[i]});
      data += reals({values.begin() + static_cast<std::ptrdiff_t>(i * n_components),
                     values.begin() + static_cast<std::ptrdiff_t>((i + 1) * n_components)});
    }
    return data + end(section);
  }

  static Numbers node_tags() {
    Numbers tags;
    for (double i = 0; i < 12; ++i) {
      tags.push_back(tag_of(i));
    }
    return tags;
  }

  [[nodiscard]] std::string file(const FourCells& four) const {
    std::string file = head() + "$PhysicalNames\n1\n3 1 \"box\"\n$EndPhysicalNames\n";
    file += "$Entities\n" + sizes({1, 0, 0, 0}) + ints({5}) + reals({0.5, 0.5, 1.5}) +
            sizes({0}) + end("Entities");
    file += nodes(four) + elements(four.nodes_read(), {5, 7, 6, 4});
    file += "$Periodic\n" + sizes({0}) + end("Periodic");
    file += "$Comments\n$Nodes\nno $EndComments\n$EndComments2\n$EndComments\n";
    file += data("NodeData", "height", 0, 1, node_tags(), four.height);
    file += data("NodeData", "position", 0, 3, node_tags(), four.points);
    // The triangles have values, too.
    file +=
        data("ElementData", "material no. 1", 0, 1, {2, 90, 80, 70, 60, 1}, {9, 3, 2, 2, 1, 9});
    return file;
  }

 private:
  static std::string text(const Numbers& values) {
    return fmt::format("{}\n", fmt::join(values, " "));
  }

  bool is_binary_;
  std::endian order_;
  std::size_t size_bytes_;
};

void expect_four_cells(const CellMesh& mesh) {
  const FourCells four;
  ASSERT_EQ(mesh.points.size(), 12U);
  for (std::size_t i = 0; i < 12; ++i) {
    EXPECT_EQ(mesh.points[i], Eigen::Vector3d(four.points[3 * i], four.points[3 * i + 1],
                                              four.points[3 * i + 2]));
  }
  EXPECT_THAT(mesh.types, ElementsAreArray({CellType::hexahedron, CellType::pyramid,
                                            CellType::wedge, CellType::tetrahedron}));
  EXPECT_THAT(mesh.nodes, ElementsAreArray(four.nodes_read()));
  EXPECT_EQ(mesh.n_left_out, 2U);
  EXPECT_EQ(mesh.n_other_wedges, 0U);
  EXPECT_THAT(mesh.numbers_in_file, ElementsAreArray({60, 70, 80, 90}));
  ASSERT_EQ(mesh.point_fields.size(), 2U);
  EXPECT_EQ(mesh.point_fields[0].name, "height");
  EXPECT_EQ(mesh.point_fields[0].values, four.height);
  EXPECT_EQ(mesh.point_fields[1].name, "position");
  EXPECT_EQ(mesh.point_fields[1].n_components, 3U);
  EXPECT_EQ(mesh.point_fields[1].values, four.points);
  ASSERT_EQ(mesh.cell_fields.size(), 1U);
  EXPECT_EQ(mesh.cell_fields[0].name, "material no. 1");
  EXPECT_EQ(mesh.cell_fields[0].values, four.material);
  // Sums of a few products of small binary fractions, divided by 6 or 2.
  EXPECT_NEAR(check_cell_mesh(mesh, "t").volume, 1.0 + 1.0 / 6 + 0.5 + 1.0 / 6, 1e-15);
}

TEST(ReadMsh, ReadsTheSameFromEveryCoding) {
  expect_four_cells(parse_msh(MshText(false).file(FourCells()), "t.msh"));
  for (const std::endian order : {std::endian::little, std::endian::big}) {
    for (const std::size_t size_bytes : {4U, 8U}) {
      SCOPED_TRACE(fmt::format("{} bytes, big {}", size_bytes, order == std::endian::big));
      expect_four_cells(parse_msh(MshText(true, order, size_bytes).file(FourCells()), "t.msh"));
    }
  }
}

TEST(ReadMsh, TakesLinesThatEndAsOnWindows) {
  std::string text = MshText(false).file(FourCells());
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += 2) {
    text.insert(at, "\r");
  }
  expect_four_cells(parse_msh(text, "t.msh"));
}

TEST(ReadMsh, ReadsTheExampleOfTheDocuments) {
  const std::string folder = std::string(HAARLIGHT_SOURCE_DIR) + "/configs/volumes/";
  const CellMesh mesh = read_cell_mesh(folder + "four_cells.msh");
  const CellMesh same = read_cell_mesh(folder + "four_cells.vtu");
  EXPECT_EQ(mesh.nodes, same.nodes);
  EXPECT_EQ(mesh.points, same.points);
  EXPECT_EQ(mesh.point_fields[0].values, same.point_fields[0].values);
  EXPECT_EQ(mesh.cell_fields[0].values, same.cell_fields[0].values);
}

/// A straight quadratic tetrahedron, its nodes tagged 1 to 10 in gmsh's order.
std::string quadratic_text() {
  const MshText msh(false);
  std::string text = msh.head() + "$Nodes\n1 10 1 10\n3 1 0 10\n1 2 3 4 5 6 7 8 9 10\n";
  text += "0 0 0 2 0 0 0 2 0 0 0 2\n";              // 0 1 2 3
  text += "1 0 0 1 1 0 0 1 0 0 0 1 0 1 1 1 0 1\n";  // 01 12 20 03 23 13
  return text +
         "$EndNodes\n$Elements\n1 1 1 1\n3 1 11 1\n1 1 2 3 4 5 6 7 8 9 10\n$EndElements\n";
}

TEST(ReadMsh, TheLastTwoNodesOfAQuadraticTetrahedronAreTheOtherWayRound) {
  const CellMesh mesh = parse_msh(quadratic_text(), "t.msh");
  EXPECT_THAT(mesh.nodes, ElementsAreArray({0, 1, 2, 3, 4, 5, 6, 7, 9, 8}));
  EXPECT_EQ(check_cell_mesh(mesh, "t").n_curved_cells, 0U);
}

TEST(ReadMsh, TagsWithoutGapsNeedNoOrder) {
  std::string text =
      replaced(quadratic_text(), "\n1 2 3 4 5 6 7 8 9 10\n0", "\n3 1 2 4 6 7 5 10 8 9\n0");
  text = replaced(text, "1 1 2 3 4 5 6 7 8 9 10\n$", "1 3 1 2 4 6 7 5 10 8 9\n$");
  EXPECT_THAT(parse_msh(text, "t.msh").nodes, ElementsAreArray({0, 1, 2, 3, 4, 5, 6, 7, 9, 8}));
}

TEST(ReadMsh, LeavesOutPointsLinesAndSurfacesOfEveryOrder) {
  // gmsh's types by order, from 1.
  const std::vector<int> lines = {1, 8, 26, 27, 28, 62, 63, 64, 65, 66};
  const std::vector<int> triangles = {2, 9, 21, 23, 25, 42, 43, 44, 45, 46};
  const std::vector<int> quadrangles = {3, 10, 36, 37, 38, 47, 48, 49, 50, 51};
  // Those with nodes on their border alone: triangles from order 3, quadrangles from 2.
  const std::vector<int> open_triangles = {20, 22, 24, 52, 53, 54, 55, 56};
  const std::vector<int> open_quadrangles = {16, 39, 40, 41, 57, 58, 59, 60, 61};
  std::vector<std::pair<int, std::size_t>> types = {{15, 1}};
  for (std::size_t i = 0; i < 10; ++i) {
    types.emplace_back(lines[i], i + 2);
    types.emplace_back(triangles[i], (i + 2) * (i + 3) / 2);
    types.emplace_back(quadrangles[i], (i + 2) * (i + 2));
  }
  for (std::size_t i = 0; i < open_triangles.size(); ++i) {
    types.emplace_back(open_triangles[i], 3 * (i + 3));
  }
  for (std::size_t i = 0; i < open_quadrangles.size(); ++i) {
    types.emplace_back(open_quadrangles[i], 4 * (i + 2));
  }
  std::string blocks = fmt::format("$Elements\n{0} {0} 1 99\n", types.size() + 1);
  std::size_t tag = 1;
  for (const auto& [type, n] : types) {
    blocks +=
        fmt::format("2 1 {} 1\n{} {}\n", type, ++tag, fmt::join(std::vector<int>(n, 1), " "));
  }
  const CellMesh mesh =
      parse_msh(replaced(quadratic_text(), "$Elements\n1 1 1 1\n", blocks), "t.msh");
  EXPECT_EQ(mesh.n_cells(), 1U);
  EXPECT_EQ(mesh.n_left_out, 48U);
}

TEST(ReadMsh, StepsAreFieldsOfTheirOwnAndPartsAreJoined) {
  const MshText msh(false);
  const Numbers tags = MshText::node_tags();
  const Numbers zero(12, 0.0);
  const Numbers one(12, 1.0);
  std::string text =
      msh.head() + msh.nodes({}) + msh.elements(FourCells().nodes_read(), {5, 7, 6, 4});
  text += msh.data("NodeData", "t", 0, 1, tags, zero) +
          msh.data("NodeData", "p", 4, 1, tags, one) +
          msh.data("NodeData", "t", 2, 1, {tags.begin(), tags.begin() + 7}, one) +
          msh.data("NodeData", "t", 2, 1, {tags.begin() + 5, tags.end()}, one);
  const CellMesh mesh = parse_msh(text, "t.msh");
  ASSERT_EQ(mesh.point_fields.size(), 3U);
  EXPECT_EQ(mesh.point_fields[0].name, "t, step 0");
  EXPECT_EQ(mesh.point_fields[0].values, zero);
  EXPECT_EQ(mesh.point_fields[1].name, "p");
  EXPECT_EQ(mesh.point_fields[2].name, "t, step 2");
  EXPECT_EQ(mesh.point_fields[2].values, one);
}

TEST(ReadMsh, ANodeOfNoCellNeedsNoValue) {
  const std::string text = replaced(
      replaced(replaced(quadratic_text(), "1 10 1 10", "1 11 1 99"), "10\n1 2", "11\n99 1 2"),
      "\n0 0 0 2", "\n7 7 7 0 0 0 2");
  const MshText msh(false);
  const CellMesh mesh = parse_msh(
      text + msh.data("NodeData", "x", 0, 1, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10}, Numbers(10, 5.0)),
      "t.msh");
  ASSERT_EQ(mesh.points.size(), 11U);
  EXPECT_TRUE(std::isnan(mesh.point_fields[0].values[0]));
  EXPECT_EQ(mesh.point_fields[0].values[10], 5.0);
  EXPECT_EQ(check_cell_mesh(mesh, "t").n_unused_points, 1U);
}

struct Broken {
  std::string bytes;
  std::string where;  ///< all of it
  std::string what;   ///< a part
};

std::vector<Broken> broken_heads() {
  const std::string good = MshText(false).file(FourCells());
  return {
      {"", "t.msh:1", "'' instead of $MeshFormat"},
      {"solid cube\n", "t.msh:1", "'solid cube' instead of $MeshFormat"},
      {"$NOD\n3\n", "t.msh:1", "version 1 of gmsh's format"},
      {replaced(good, "4.1 0 8", "2.2 0 8"), "t.msh:2", "version '2.2' of gmsh's format"},
      {replaced(good, "4.1 0 8", "4 0 8"), "t.msh:2", "version '4' of gmsh's format"},
      {replaced(good, "4.1 0 8", "4.1 2 8"), "t.msh:2", "'4.1 2 8' instead of '4.1 0 8'"},
      {replaced(good, "4.1 0 8", "4.1 0 16"), "t.msh:2", "'4.1 0 16' instead of"},
      {replaced(good, "$EndMeshFormat", "$Nodes"), "t.msh:3",
       "'$Nodes' instead of $EndMeshFormat"},
      {good.substr(0, good.find("$Nodes")), "t.msh:14", "no $Nodes before the end"},
      {good.substr(0, good.find("$Elements")), "t.msh:43", "no $Elements before the end"},
      {replaced(good, "$EndEntities", "$EndEnties"), "t.msh:8",
       "no $EndEntities before the end"},
      {replaced(good, "$Periodic", "Periodic"), "t.msh:85", "'Periodic' instead of a section"},
      {replaced(good, "$Periodic", "$EndPeriodic"), "t.msh:85",
       "'$EndPeriodic' instead of a section"},
      {replaced(good, "$Comments\n$Nodes", "$Nodes"), "t.msh:88", "$Nodes for the second time"},
      {replaced(good, "$Comments\n$Nodes", "$Elements"), "t.msh:88",
       "$Elements for the second time"},
      {replaced(good, "$Entities", "$Elements"), "t.msh:8", "$Elements before $Nodes"},
      {good + "$ElementNodeData\n", "t.msh:183", "values of each element at its nodes"},
  };
}

std::vector<Broken> broken_nodes() {
  const std::string good = MshText(false).file(FourCells());
  return {
      {replaced(good, "3 12 2 1000", "3 -12 2 1000"), "t.msh:15", "'-12' instead of a count"},
      {replaced(good, "3 12 2 1000", "3 1e2 2 1000"), "t.msh:15", "'1e2' instead of a count"},
      {replaced(good, "3 12 2 1000", "3 5000000000 2 1000"), "t.msh:15",
       "more than 4 thousand million nodes"},
      {replaced(good, "3 12 2 1000", "3 1000000000 2 1000"), "t.msh:15",
       "1000000000 nodes in the"},
      {replaced(good, "3 12 2 1000", "3 13 2 1000"), "t.msh:15",
       "12 nodes in all blocks, where the section says 13"},
      {replaced(good, "3 12 2 1000", "3 11 2 1000"), "t.msh:31",
       "a block of 3 nodes, where the section has 2 left"},
      {replaced(good, "3 12 2 1000", "2 12 2 1000"), "t.msh:15", "9 nodes in all blocks"},
      {replaced(good, "3 1 0\n8", "4 1 0\n8"), "t.msh:16", "a block of nodes of dimension 4"},
      {replaced(good, "3 1 0\n8", "3 1 2\n8"), "t.msh:16", "parametric 2"},
      {replaced(good, "2 1 1\n3", "2 1 0\n3"), "t.msh:39", "'0.75' instead of $EndNodes"},
      {replaced(good, "993", "1000"), "t.msh:15", "node 1000 stands there twice"},
      {replaced(good, "0.5 0.5 1.5\n2 1 1", "0.5 O.5 1.5\n2 1 1"), "t.msh:30",
       "'O.5' is not a number"},
      {good.substr(0, good.find("0.25 0.75")), "t.msh:32",
       "3 nodes in the 19 bytes that are left"},
  };
}

std::vector<Broken> broken_elements() {
  const MshText msh(false);
  const std::string good = msh.file(FourCells());
  const auto of_type = [&](double type) {
    return msh.head() + msh.nodes({}) + msh.elements(FourCells().nodes_read(), {5, 7, type, 4});
  };
  return {
      {replaced(good, "5 6 1 90", "5 7 1 90"), "t.msh:44",
       "6 elements in all blocks, where the section says 7"},
      {replaced(good, "5 6 1 90", "4 6 1 90"), "t.msh:44", "5 elements in all blocks"},
      {replaced(good, "2 1 2\n2", "2 1 2\n200000000"), "t.msh:46", "200000000 elements in the"},
      {replaced(good, "60\n1000", "60\n999"), "t.msh:52",
       "cell 60 names node 999, which is not there"},
      {replaced(good, "60\n1000", "70\n1000"), "t.msh:44", "element 70 stands there twice"},
      {of_type(13), "t.msh:58", "cell 80 is a prism of 18 nodes (gmsh's type 13)"},
      {of_type(14), "t.msh:58", "cell 80 is a pyramid of 14 nodes (gmsh's type 14)"},
      {of_type(30), "t.msh:58", "cell 80 is a tetrahedron of 35 nodes (gmsh's type 30)"},
      {of_type(139), "t.msh:58", "cell 80 is a cell of another kind (gmsh's type 139)"},
      {of_type(5), "t.msh:67", "cell 80 names node 3, which is not there"},
      {of_type(7), "t.msh:74", "'$EndElements' instead of a count or a tag"},
  };
}

std::vector<Broken> broken_data() {
  const std::string good = MshText(false).file(FourCells());
  const std::string height = "\"height\"\n1\n0.5\n3\n0\n1\n12\n";
  const auto with = [&](std::string_view by) { return replaced(good, height, by); };
  return {
      {with("height\n1\n0.5\n3\n0\n1\n12\n"), "t.msh:95",
       "'height' instead of a name in quotes"},
      {with("\"height\"\n1\n0.5\n2\n0\n1\n"), "t.msh:93",
       "a field of 1 string tags and 2 integer tags"},
      {with("\"height\"\n1\n0.5\n3\n0\n0\n12\n"), "t.msh:93", "'height' has 0 components"},
      {with("\"height\"\n1\n0.5\n3\n0\n1001\n12\n"), "t.msh:93",
       "'height' has 1001 components"},
      {with("\"height\"\n1\n0.5\n3\n0\n1\n12 0\n"), "t.msh:101", "'0' behind the count"},
      {with("\"height\"\n1\n0.5\n3\nx\n1\n12\n"), "t.msh:99", "'x' instead of a whole number"},
      {with("\"height\"\n1\n0.5\n3\n0\n1\n13\n"), "t.msh:126", "'$EndNodeData' instead of"},
      {with("\"height\"\n1\n0.5\n3\n0\n1\n1300000\n"), "t.msh:102", "1300000 nodes in the"},
      {with("\"height\"\n1\n0.5\n3\n0\n1\n11\n"), "t.msh:124", "instead of $EndNodeData"},
      {replaced(good, "12\n1000\n", "12\n999\n"), "t.msh:93",
       "'height' gives a value to node 999, which is not there"},
      {replaced(good, "12\n1000\n", "12\n-1\n"), "t.msh:102", "a value to tag -1"},
      {replaced(good, "12\n1000\n0\n", "12\n993\n0.5\n"), "t.msh:93",
       "'height' gives node 993 a second value"},
      {replaced(replaced(good, height, "\"height\"\n1\n0.5\n3\n0\n1\n11\n"), "923\n0.25\n", ""),
       "t.msh:93", "'height' has no value for node 923"},
      {replaced(good, "6\n2\n9\n90\n3\n", "5\n2\n9\n"), "t.msh:161",
       "'material no. 1' has no value for element 90"},
      {replaced(good, "6\n2\n9\n", "6\n3\n9\n"), "t.msh:161",
       "gives a value to element 3, which is not there"},
      {replaced(good, "1\n\"height\"", "2\n\"height\"\n\"scheme\""), "t.msh:93",
       "'height' is interpolated by a scheme of its own, 'scheme'"},
      {replaced(good, "\"position\"", "\"height\""), "t.msh:127",
       "'height' has 3 components, and 1 before"},
  };
}

std::vector<Broken> broken_binary() {
  const std::string good = MshText(true).file(FourCells());
  const auto place = [&](std::string_view word, int after = 0) {
    return fmt::format("t.msh: byte {}",
                       static_cast<int>(good.find(word) + word.size()) + after);
  };
  const auto with_byte = [&](std::string_view word, std::size_t after, char byte) {
    std::string bytes = good;
    bytes[good.find(word) + word.size() + after] = byte;
    return bytes;
  };
  return {
      {with_byte("4.1 1 8\n", 0, '\2'), place("4.1 1 8\n"), "2 instead of the binary 1"},
      {good.substr(0, good.find("4.1 1 8") + 10), place("4.1 1 8\n"), "ends within a number"},
      {with_byte("$Nodes\n", 15, '\1'), place("$Nodes\n"),
       "more than 4 thousand million nodes"},
      {with_byte("$Nodes\n", 11, '\1'), place("$Nodes\n", 32), "16777228 nodes in the"},
      {with_byte("$Nodes\n", 8, '\13'), place("$Nodes\n", 360), "a block of 3 nodes, where"},
      {with_byte("$Nodes\n", 32, '\7'), place("$Nodes\n", 32), "of dimension 7"},
      {with_byte("$Nodes\n", 47, '\1'), place("$Nodes\n", 52), "nodes in the"},
      {with_byte("$Elements\n", 0, '\6'), place("\n$EndElements", -13),
       "elements of type 1953391981, which gmsh does not have"},
      {with_byte("$Elements\n", 8, '\7'), place("$Elements\n"), "6 elements in all blocks"},
      {with_byte("$Elements\n", 40, '\15'), place("$Elements\n", 32),
       "is a prism of 18 nodes (gmsh's type 13)"},
      {with_byte("$Elements\n", 47, '\1'), place("$Elements\n", 52), "elements in the"},
      {with_byte("0.5\n3\n0\n1\n12\n", 3, '\1'), place("$NodeData", -9),
       "'height' gives a value to node 16778216, which is not there"},
      {good.substr(0, good.size() - 30), place("no. 1\"\n1\n0.5\n3\n0\n1\n6\n"),
       "6 elements in the 59 bytes that are left"},
      {good.substr(0, good.find("$Periodic") + 12), place("$EndElements\n"),
       "no $EndPeriodic before the end"},
  };
}

TEST(ReadMsh, RefusesBrokenFilesByPlaceAndCause) {
  const std::size_t n_broken = test::expect_refused<Broken>(
      {broken_heads(), broken_nodes(), broken_elements(), broken_data(), broken_binary()},
      [](const Broken& item) { static_cast<void>(parse_msh(item.bytes, "t.msh")); });
  EXPECT_GE(n_broken, 60U);
}

}  // namespace
}  // namespace haarlight::render
