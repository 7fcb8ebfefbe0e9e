// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/vtu_writer.h"
#include "tests/render/cell_mesh/broken_meshes.h"
#include "tests/render/cell_mesh/mesh_bytes.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using ::testing::ElementsAreArray;
using testing::FourCells;
using ::testing::HasSubstr;
using testing::replaced;
using ::testing::ThrowsMessage;
using testing::VtuEncoding;
using testing::VtuText;
using Place = VtuEncoding::Place;

void expect_four_cells(const CellMesh& mesh, const std::string& of) {
  const FourCells four;
  ASSERT_EQ(mesh.points.size(), 12U) << of;
  for (std::size_t i = 0; i < 12; ++i) {
    EXPECT_EQ(mesh.points[i], Eigen::Vector3d(four.points[3 * i], four.points[3 * i + 1],
                                              four.points[3 * i + 2]))
        << of;
  }
  EXPECT_THAT(mesh.types, ElementsAreArray({CellType::hexahedron, CellType::pyramid,
                                            CellType::wedge, CellType::tetrahedron}))
      << of;
  EXPECT_THAT(mesh.nodes, ElementsAreArray(four.nodes_read())) << of;
  EXPECT_THAT(mesh.begins, ElementsAreArray({0, 8, 13, 19})) << of;
  ASSERT_EQ(mesh.point_fields.size(), 2U) << of;
  EXPECT_EQ(mesh.point_fields[0].name, "height") << of;
  EXPECT_EQ(mesh.point_fields[0].values, four.height) << of;
  EXPECT_EQ(mesh.point_fields[1].n_components, 3U) << of;
  EXPECT_EQ(mesh.point_fields[1].values, four.points) << of;
  ASSERT_EQ(mesh.cell_fields.size(), 1U) << of;
  EXPECT_EQ(mesh.cell_fields[0].values, four.material) << of;
}

TEST(ReadVtu, ReadsTheSameFromEveryEncoding) {
  int n_read = 0;
  for (const Place place :
       {Place::ascii, Place::binary, Place::appended_base64, Place::appended_raw}) {
    for (const bool is_compressed : {false, true}) {
      for (const bool has_wide_sizes : {false, true}) {
        for (const std::endian order : {std::endian::little, std::endian::big}) {
          const std::string text =
              FourCells().vtu({place, is_compressed, has_wide_sizes, order});
          expect_four_cells(
              parse_vtu(text, "t.vtu"),
              fmt::format("form {}, compressed {}, wide {}, big {}", static_cast<int>(place),
                          is_compressed, has_wide_sizes, order == std::endian::big));
          ++n_read;
        }
      }
    }
  }
  EXPECT_EQ(n_read, 32);
}

TEST(ReadVtu, ReadsTheExampleOfTheDocuments) {
  const CellMesh mesh =
      read_cell_mesh(std::string(HAARLIGHT_SOURCE_DIR) + "/configs/volumes/four_cells.vtu");
  EXPECT_THAT(mesh.nodes, ElementsAreArray(FourCells().nodes_read()));
  // Sums of a few products of small binary fractions, divided by 6 or 2.
  EXPECT_NEAR(check_cell_mesh(mesh, "t").volume, 1.0 + 1.0 / 6 + 0.5 + 1.0 / 6, 1e-15);
}

TEST(ReadVtu, ReadsEveryTypeOfNumber) {
  const std::vector<double> values = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 120};
  for (const std::endian order : {std::endian::little, std::endian::big}) {
    VtuText vtu({.place = Place::binary, .order = order});
    const FourCells four;
    std::string fields;
    fields += vtu.array<std::int8_t>("Int8", "a", 1, values);
    fields += vtu.array<std::uint8_t>("UInt8", "b", 1, values);
    fields += vtu.array<std::int16_t>("Int16", "c", 1, values);
    fields += vtu.array<std::uint16_t>("UInt16", "d", 1, values);
    fields += vtu.array<std::int32_t>("Int32", "e", 1, values);
    fields += vtu.array<std::uint32_t>("UInt32", "f", 1, values);
    fields += vtu.array<std::int64_t>("Int64", "g", 1, values);
    fields += vtu.array<std::uint64_t>("UInt64", "h", 1, values);
    fields += vtu.array<float>("Float32", "i", 1, values);
    fields += vtu.array<double>("Float64", "j", 1, values);
    const std::string piece =
        replaced(four.piece(vtu), "<PointData>\n", "<PointData>\n" + fields);
    const CellMesh mesh = parse_vtu(vtu.file(piece), "t.vtu");
    ASSERT_EQ(mesh.point_fields.size(), 12U);
    for (std::size_t i = 0; i < 10; ++i) {
      EXPECT_EQ(mesh.point_fields[i].values, values) << mesh.point_fields[i].name;
    }
  }
}

TEST(ReadVtu, JoinsPiecesAndLeavesOutSurfaces) {
  VtuText vtu({});
  FourCells flat;
  flat.types[1] = 7;  // the pyramid's nodes as a polygon
  const std::string pieces = flat.piece(vtu) +
                             "<Piece NumberOfPoints=\"0\" NumberOfCells=\"0\"/>\n" +
                             FourCells().piece(vtu);
  const CellMesh mesh = parse_vtu(vtu.file(pieces), "t.vtu");
  EXPECT_EQ(mesh.points.size(), 24U);
  EXPECT_EQ(mesh.n_cells(), 7U);
  EXPECT_EQ(mesh.n_left_out, 1U);
  EXPECT_THAT(mesh.numbers_in_file, ElementsAreArray({0, 2, 3, 4, 5, 6, 7}));
  EXPECT_THAT(mesh.cell_fields[0].values, ElementsAreArray({1, 2, 3, 1, 2, 2, 3}));
  EXPECT_THAT(mesh.nodes_of(3), ElementsAreArray({12, 13, 14, 15, 16, 17, 18, 19}));
  EXPECT_EQ(check_cell_mesh(mesh, "t").n_parts, 2U);
}

TEST(ReadVtu, TakesAWedgeOfTheOtherOrderAndAVoxel) {
  FourCells four;
  four.types[0] = 11;
  std::swap(four.nodes[2], four.nodes[3]);
  std::swap(four.nodes[6], four.nodes[7]);
  std::swap_ranges(four.nodes.begin() + 13, four.nodes.begin() + 16, four.nodes.begin() + 16);
  const CellMesh mesh = parse_vtu(four.vtu({}), "t.vtu");
  EXPECT_THAT(mesh.nodes, ElementsAreArray(FourCells().nodes_read()));
  EXPECT_EQ(mesh.n_other_wedges, 1U);
}

TEST(ReadVtu, ReadsWhatOursWrites) {
  const testing::TemporaryFolder folder;
  HexahedralMesh written;
  written.points = {{0, 0, 0}, {2, 0, 0}, {2, 3, 0}, {0, 3, 0}, {0, 0, 4}, {2, 0, 4},
                    {2, 3, 4}, {0, 3, 4}, {0, 0, 5}, {2, 0, 5}, {2, 3, 5}, {0, 3, 5}};
  written.cells = {{0, 1, 2, 3, 4, 5, 6, 7}, {4, 5, 6, 7, 8, 9, 10, 11}};
  written.values = {{"state", std::vector<std::uint8_t>{1, 200}},
                    {"opacity", std::vector<float>{0.5F, -2.0F}}};
  write_vtu(written, folder.path() / "a.vtu");
  const CellMesh mesh = read_cell_mesh(folder.path() / "a.vtu");
  ASSERT_EQ(mesh.n_cells(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_THAT(mesh.nodes_of(i), ElementsAreArray(written.cells[i]));
  }
  EXPECT_EQ(mesh.points[10], Eigen::Vector3d(2, 3, 5));
  EXPECT_THAT(mesh.cell_fields[0].values, ElementsAreArray({1, 200}));
  EXPECT_THAT(mesh.cell_fields[1].values, ElementsAreArray({0.5, -2.0}));
  EXPECT_EQ(check_cell_mesh(mesh, "t").volume, 30.0);
}

void expect_same(const CellMesh& mesh, const CellMesh& other) {
  EXPECT_EQ(mesh.points, other.points);
  EXPECT_EQ(mesh.types, other.types);
  EXPECT_EQ(mesh.begins, other.begins);
  EXPECT_EQ(mesh.nodes, other.nodes);
  for (const auto fields : {&CellMesh::point_fields, &CellMesh::cell_fields}) {
    ASSERT_EQ((mesh.*fields).size(), (other.*fields).size());
    for (std::size_t i = 0; i < (mesh.*fields).size(); ++i) {
      EXPECT_EQ((mesh.*fields)[i].name, (other.*fields)[i].name);
      EXPECT_EQ((mesh.*fields)[i].n_components, (other.*fields)[i].n_components);
      EXPECT_EQ((mesh.*fields)[i].values, (other.*fields)[i].values);
    }
  }
}

TEST(WriteVtu, KeepsCellsOfEveryTypeAndTheirFields) {
  const testing::TemporaryFolder folder;
  CellMesh mesh = parse_vtu(FourCells().vtu({}), "t.vtu");
  // Another part: a quadratic tetrahedron, beside them.
  const auto first = static_cast<std::uint32_t>(mesh.points.size());
  const std::array<Eigen::Vector3d, 4> corners = {
      Eigen::Vector3d(20, 0, 0.1), Eigen::Vector3d(21, 0, 1.0 / 3.0), Eigen::Vector3d(20, 1, 0),
      Eigen::Vector3d(20, 0, 1e-300)};
  mesh.types.push_back(CellType::quadratic_tetrahedron);
  mesh.begins.push_back(mesh.nodes.size());
  for (const Eigen::Vector3d& corner : corners) {
    mesh.points.push_back(corner);
  }
  for (const auto& [a, b] : kQuadraticEdges) {
    mesh.points.emplace_back(0.5 * (corners.at(a) + corners.at(b)));
  }
  for (std::uint32_t i = first; i < mesh.points.size(); ++i) {
    mesh.nodes.push_back(i);
  }
  for (MeshField& field : mesh.point_fields) {
    field.values.resize(mesh.points.size() * field.n_components, 1.0 / 7.0);
  }
  for (MeshField& field : mesh.cell_fields) {
    field.values.resize(mesh.n_cells() * field.n_components, -1e300);
  }
  mesh.point_fields.push_back({.name = "a \"<b>\" & 'c' \xc3\xa9",
                               .n_components = 1,
                               .values = std::vector<double>(mesh.points.size(), 2.0)});
  write_vtu(mesh, folder.path() / "a.vtu");
  const CellMesh read = read_cell_mesh(folder.path() / "a.vtu");
  expect_same(read, mesh);
  EXPECT_EQ(read.n_other_wedges, 0U);
}

TEST(WriteVtu, RefusesANameThatXmlCannotHold) {
  const testing::TemporaryFolder folder;
  CellMesh mesh = parse_vtu(FourCells().vtu({}), "t.vtu");
  mesh.point_fields[0].name = "a\x01";
  EXPECT_THAT([&] { write_vtu(mesh, folder.path() / "a.vtu"); },
              ThrowsMessage<Error>(HasSubstr("control characters")));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "a.vtu"));
}

struct Broken {
  std::string bytes;
  std::string where;  ///< all of it
  std::string what;   ///< a part
};

std::vector<Broken> broken_xml() {
  const std::string good = FourCells().vtu({});
  return {
      {"", "t.vtu:1", "not XML"},
      {"# vtk DataFile Version 2.0\n", "t.vtu:2", "not XML"},
      {good.substr(0, good.find("</CellData>")), "t.vtu:15", "not XML"},
      {"<a/>", "t.vtu:1", "no element VTKFile"},
      {replaced(good, "\"UnstructuredGrid\"", "\"ImageData\""), "t.vtu:1", "type 'ImageData'"},
      {replaced(good, "LittleEndian", "Mixed"), "t.vtu:1", "byte_order 'Mixed'"},
      {replaced(good, "UInt32", "UInt16"), "t.vtu:1", "header_type 'UInt16'"},
      {replaced(good, "header_type", "compressor=\"vtkLZ4DataCompressor\" header_type"),
       "t.vtu:1", "compressor 'vtkLZ4DataCompressor' is not read"},
      {"<VTKFile type=\"UnstructuredGrid\">\n</VTKFile>", "t.vtu:1",
       "no element UnstructuredGrid"},
      {"<VTKFile type=\"UnstructuredGrid\">\n<UnstructuredGrid/></VTKFile>", "t.vtu:2",
       "no Piece"},
      {replaced(good, "NumberOfPoints", "Points"), "t.vtu:3", "Piece without NumberOfPoints"},
      {replaced(good, "NumberOfCells=\"4\"", "NumberOfCells=\"-4\""), "t.vtu:3", "is '-4'"},
      {replaced(good, "NumberOfCells=\"4\"", "NumberOfCells=\"99999999999999999999\""),
       "t.vtu:3", "NumberOfCells"},
      {replaced(good, "NumberOfPoints=\"12\"", "NumberOfPoints=\"6148914691236517206\""),
       "t.vtu:18", "6148914691236517206 items of 3 components"},
      {replaced(good, "NumberOfPoints=\"12\"", "NumberOfPoints=\"11\""), "t.vtu:18",
       "more than its 33 numbers"},
      {replaced(good, "NumberOfPoints=\"12\"", "NumberOfPoints=\"13\""), "t.vtu:18",
       "36 numbers instead of 39"},
      {replaced(good, "Name=\"Points\" NumberOfComponents=\"3\"", "NumberOfComponents=\"2\""),
       "t.vtu:18", "points of 2 components"},
      {replaced(good, "<Points>", "<Places>"), "t.vtu:21", "not XML"},
      {replaced(good, "Name=\"types\"", "Name=\"kinds\""), "t.vtu:22", "no DataArray 'types'"},
      {replaced(good, "\"Float64\" Name=\"height\"", "\"Bit\" Name=\"height\""), "t.vtu:5",
       "numbers of type 'Bit'"},
      {replaced(good, "format=\"ascii\"", "format=\"morse\""), "t.vtu:5", "format 'morse'"},
      {replaced(good, "NumberOfComponents=\"1\"", "NumberOfComponents=\"0\""), "t.vtu:5",
       "0 components"},
      {replaced(good, "0 0 0 0 1 1", "0 0 0 O 1 1"), "t.vtu:6", "'O' is not a number"},
      {replaced(good, "0 0 0 0 1 1", "0 0 0 1e999 1 1"), "t.vtu:6", "'1e999' is not a number"},
  };
}

std::vector<Broken> broken_cells() {
  const std::string good = FourCells().vtu({});
  const auto with = [&](auto change) {
    FourCells four;
    change(four);
    return four.vtu({});
  };
  return {
      {with([](FourCells& f) { f.nodes[3] = 12; }), "t.vtu:22", "cell 0 names point 12 of 12"},
      {with([](FourCells& f) { f.nodes[22] = -1; }), "t.vtu:22", "cell 3 names point -1 of 12"},
      {with([](FourCells& f) { f.nodes[9] = 0.5; }), "t.vtu:22", "cell 1 names point 0.5"},
      {with([](FourCells& f) { f.types[2] = 33; }), "t.vtu:22",
       "cell 2 is a hexahedron of 24 nodes (VTK's type 33)"},
      {with([](FourCells& f) { f.types[2] = 42; }), "t.vtu:22", "cell 2 is a polyhedron"},
      {with([](FourCells& f) { f.types[2] = 256; }), "t.vtu:22", "cell 2 is of type 256"},
      {with([](FourCells& f) { f.types[2] = 14; }), "t.vtu:22",
       "cell 2 is a pyramid of 6 nodes instead of 5"},
      {with([](FourCells& f) { f.ends[1] = 7; }), "t.vtu:22", "cell 1 ends at node 7 of 23"},
      {with([](FourCells& f) { f.ends[3] = 24; }), "t.vtu:22", "cell 3 ends at node 24 of 23"},
      {with([](FourCells& f) { f.nodes.push_back(1); }), "t.vtu:22",
       "1 nodes belong to no cell"},
  };
}

std::vector<Broken> broken_arrays() {
  using ::haarlight::testing::to_base64;
  const std::string base64 = FourCells().vtu({.place = Place::binary});
  const std::string raw = FourCells().vtu({.place = Place::appended_raw});
  const std::string zipped =
      FourCells().vtu({.place = Place::appended_raw, .is_compressed = true});
  const std::size_t zipped_at = zipped.find("\n_") + 2;
  const auto with_size = [&](std::size_t i, char byte) {
    std::string bytes = zipped;
    bytes[zipped_at + i] = byte;
    return bytes;
  };
  return {
      {replaced(base64, "\n  YAAAA", "\n  Y*AAA"), "t.vtu:5", "'height': byte 0x2a in base64"},
      {replaced(base64, "\n  YAAAA", "\n  YQAAA"), "t.vtu:5",
       "the array says 97 bytes, its type and number of items make 96"},
      {replaced(base64, "</DataArray>", "</DataArray>")
           .replace(base64.find("\n</DataArray>") - 8, 8, ""),
       "t.vtu:5", "the array ends too early"},
      {replaced(base64, "UInt32", "UInt64"), "t.vtu:18", "'Points': the array ends too early"},
      {replaced(raw, "offset=\"0\"", "offset=\"100000\""), "t.vtu:5", "offset 100000 in"},
      {replaced(raw, " offset=\"0\"", ""), "t.vtu:5", "without offset"},
      {replaced(raw, "\n_", "\n#"), "t.vtu:21", "without their first '_'"},
      {replaced(raw, "encoding=\"raw\"", "encoding=\"hex\""), "t.vtu:21", "encoding 'hex'"},
      {raw.substr(0, raw.find("\n_") + 300), "t.vtu:12", "the array ends too early"},
      {replaced(raw, "LittleEndian", "BigEndian"), "t.vtu:12",
       "'Points': the array says 536936448 bytes"},
      {with_size(0, '\7'), "t.vtu:5", "the array says 112 bytes, its type and number"},
      {with_size(3, '\x7f'), "t.vtu:5", "compressed blocks, more than the file holds"},
      {with_size(8, '\x11'), "t.vtu:5", "compressed blocks of 16 bytes, the last of 17"},
      {with_size(12, '\1'), "t.vtu:5", "not zlib's"},
      {with_size(12 + 6 * 4, '\0'), "t.vtu:5", "not zlib's"},
      {with_size(14, '\x7f'), "t.vtu:5", "the array ends too early"},
  };
}

TEST(ReadVtu, RefusesBrokenFilesByPlaceAndCause) {
  const std::size_t n_broken = test::expect_refused<Broken>(
      {broken_xml(), broken_cells(), broken_arrays()},
      [](const Broken& item) { static_cast<void>(parse_vtu(item.bytes, "t.vtu")); });
  EXPECT_GE(n_broken, 50U);
}

/// The four cells, whose connectivity (its size stands nowhere else) is one block that claims
/// to hold `n` bytes.
std::string claiming_block(std::size_t n, const std::string& block) {
  const std::string claim =
      testing::to_base64(testing::bytes_of<std::uint32_t>(std::vector<double>{
          1, static_cast<double>(n), 0, static_cast<double>(block.size())})) +
      testing::to_base64(block);
  std::string text = replaced(FourCells().vtu({}), "header_type",
                              "compressor=\"vtkZLibDataCompressor\" header_type");
  const std::size_t begin = text.find("\"connectivity\"");
  text.replace(text.find("ascii", begin), 5, "binary");
  const std::size_t numbers = text.find('\n', begin) + 1;
  return text.replace(numbers, text.find('\n', numbers) - numbers, claim);
}

TEST(ReadVtu, RefusesABlockThatClaimsMoreThanItCanHold) {
  // 4 million values are within what any file may hold, 256 million are not within what 2 kB may.
  for (const auto& [n, what] : {std::pair(1U << 24U, "zlib packs no denser than 1032 to 1"),
                                std::pair(1U << 30U, "more than such a file is read for")}) {
    try {
      static_cast<void>(parse_vtu(claiming_block(n, "abc"), "t.vtu"));
      ADD_FAILURE() << what;
    } catch (const Error& error) {
      EXPECT_THAT(error.problem(), HasSubstr("'connectivity': "));
      EXPECT_THAT(error.problem(), HasSubstr(what));
    }
  }
}

TEST(ReadVtu, RefusesABlockThatHoldsLessThanItSays) {
  const std::string block = testing::deflate("1234");
  EXPECT_THROW(static_cast<void>(parse_vtu(claiming_block(3, block), "t.vtu")), Error);
  try {
    static_cast<void>(parse_vtu(claiming_block(8, block), "t.vtu"));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("not of the size that the array says"));
  }
}

TEST(ReadVtu, RefusesMoreValuesThanItsFileMayHold) {
  // Fields that all name the same 50 000 bytes. A file of 150 kB may hold 64 values for each of
  // its bytes and 2^23: 18 million, some more as its text grows.
  const std::size_t n = 50000;
  VtuText vtu({.place = Place::appended_raw});
  const std::string points =
      vtu.array<std::uint8_t>("UInt8", "Points", 3, std::vector<double>(3 * n, 0.0));
  const std::string field =
      vtu.array<std::uint8_t>("UInt8", "a", 1, std::vector<double>(n, 1.0));
  const auto file_of = [&](int n_fields) {
    std::string fields;
    for (int i = 0; i < n_fields; ++i) {
      fields += field;
    }
    return vtu.file(fmt::format(
        "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"0\"><Points>{}</Points><Cells>"
        "<DataArray type=\"Int8\" Name=\"connectivity\"/><DataArray type=\"Int8\" "
        "Name=\"offsets\"/><DataArray type=\"Int8\" Name=\"types\"/></Cells><PointData>{}"
        "</PointData></Piece>",
        n, points, fields));
  };
  EXPECT_EQ(parse_vtu(file_of(20), "t.vtu").point_fields.size(), 20U);
  try {
    static_cast<void>(parse_vtu(file_of(520), "t.vtu"));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("50000 items of 1 components in a file of"));
  }
}

TEST(ReadVtu, RefusesPiecesOfOtherFields) {
  VtuText vtu({});
  const std::string second = replaced(FourCells().piece(vtu), "\"height\"", "\"depth\"");
  const std::string text = vtu.file(FourCells().piece(vtu) + second);
  try {
    static_cast<void>(parse_vtu(text, "t.vtu"));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("'depth' of 1 components"));
  }
}

}  // namespace
}  // namespace haarlight::render
