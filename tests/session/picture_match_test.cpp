// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/picture_match.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

/// A folder with files of these names (paths below it), each with bytes of its own.
struct Files {
  TemporaryFolder folder;
  [[nodiscard]] fs::path in() const { return folder.path() / "in"; }
  void add(const std::string& name) const {
    fs::create_directories((folder.path() / name).parent_path());
    test::write_text(folder.path() / name, "bytes of " + name);
  }
};

struct Match {
  std::vector<std::string> paths;  ///< below the whole folder
  std::vector<std::string> notes;
  std::vector<std::string> disagreements;
  std::string refusal;
};

Match match(const Files& files, const std::string& lp, const MatchOptions& options = {}) {
  test::write_text(files.folder.path() / "l.lp", lp);
  Match out;
  try {
    LightList list = read_light_file(files.folder.path() / "l.lp");
    for (const LightPicture& picture :
         match_pictures(files.in(), files.folder.path() / "l.lp", list, options)) {
      out.paths.push_back(fs::relative(picture.path, files.folder.path()).string());
    }
    out.notes = list.notes;
    out.disagreements = list.disagreements;
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty()) << error.what();
    out.refusal = error.what();
  }
  return out;
}

std::string lines(const std::vector<std::string>& names, int announced = -1) {
  std::string lp =
      fmt::format("{}\n", announced < 0 ? static_cast<int>(names.size()) : announced);
  for (std::size_t k = 0; k < names.size(); ++k) {
    lp += fmt::format("{} {} 0 {}\n", names[k], k % 2 == 0 ? 0.6 : 0.0, k % 2 == 0 ? 0.8 : 1.0);
  }
  return lp;
}

class PictureMatch : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* name : {"a.jpg", "b.jpg", "c.jpg"}) {
      files_.add(std::string("in/") + name);
    }
  }
  [[nodiscard]] Match of(const std::vector<std::string>& names,
                         const MatchOptions& options = {}, int announced = -1) const {
    return match(files_, lines(names, announced), options);
  }
  Files files_;
};

TEST_F(PictureMatch, TakesWhatTheListNames) {
  const Match m = of({"a.jpg", "b.jpg", "c.jpg"});
  EXPECT_THAT(m.paths, ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  EXPECT_THAT(m.disagreements, IsEmpty());
  EXPECT_THAT(of({"a.jpg", "b.jpg", "c.jpg"}, {.is_strict = true}).refusal, IsEmpty());
}

// A missing picture that lies beside the list, above the folder, or anywhere else is another's.
TEST_F(PictureMatch, NeverLeavesTheFolder) {
  files_.add("d.jpg");
  files_.add("other/d.jpg");
  const std::string away = (files_.folder.path() / "other/d.jpg").string();
  for (const std::string& name :
       {std::string("d.jpg"), std::string("../d.jpg"), std::string("../other/d.jpg"),
        std::string("x/../../d.jpg"), std::string("..\\other\\d.jpg"), std::string("D.JPG"),
        std::string("other/d.jpg"), std::string("C:\\other\\d.jpg"), std::string(".."),
        std::string("in/.."), away}) {
    const Match m = of({"a.jpg", name});
    EXPECT_THAT(m.refusal, AllOf(HasSubstr("is missing"), HasSubstr("--pictures-from")))
        << name;
  }
}

TEST_F(PictureMatch, LeavesItWhereToldAndSaysSo) {
  files_.add("other/sub/d.jpg");
  const fs::path other = files_.folder.path() / "other";
  const Match m = of({"a.jpg", "b.jpg", "c.jpg", "sub\\d.jpg"}, {.pictures_from = other});
  EXPECT_THAT(m.paths, ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg", "other/sub/d.jpg"));
  EXPECT_THAT(m.notes, ElementsAre(AllOf(HasSubstr("sub\\d.jpg"), HasSubstr("other"))));
  // The folder itself comes first.
  files_.add("other/sub/a.jpg");
  EXPECT_THAT(of({"sub/a.jpg", "b.jpg", "c.jpg"}, {.pictures_from = other}).paths,
              ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
}

TEST_F(PictureMatch, FindsWhatAnotherMachineNamed) {
  files_.add("in/sub/d.jpg");
  EXPECT_THAT(of({"jpeg-exports/a.jpg", "C:\\set\\b.jpg", "/scans/x/c.jpg"}).paths,
              ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  const Match m = of({"jpeg-exports/a.jpg", "C:\\set\\b.jpg", "/scans/x/c.jpg"});
  EXPECT_THAT(m.disagreements, ElementsAre(HasSubstr("by the last part of the name")));
  EXPECT_THAT(of({"jpeg-exports/a.jpg", "b.jpg", "c.jpg"}, {.is_strict = true}).refusal,
              HasSubstr("jpeg-exports/a.jpg"));
  // From where the list stands, as `haarlight export --png` writes it: nothing to warn of.
  EXPECT_THAT(of({"in/a.jpg", "in/b.jpg", "in\\c.jpg"}, {.is_strict = true}).paths,
              ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  // As written wins: below the folder it is no other machine's.
  EXPECT_THAT(of({"sub\\d.jpg", "a.jpg", "b.jpg", "c.jpg"}).paths[0], "in/sub/d.jpg");
  EXPECT_THAT(of({"./sub/../sub/d.jpg", "a.jpg", "b.jpg", "c.jpg"}).paths[0], "in/sub/d.jpg");
}

TEST_F(PictureMatch, LettersCaseIsSaid) {
  const Match m = of({"A.JPG", "b.Jpg", "c.jpg"});
  EXPECT_THAT(m.paths, ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  EXPECT_THAT(m.disagreements, ElementsAre(HasSubstr("another case")));
  files_.add("in/B.jpg");
  EXPECT_THAT(of({"a.jpg", "b.JPG"}).refusal, AllOf(HasSubstr("b.JPG"), HasSubstr("B.jpg")));
  EXPECT_THAT(of({"a.jpg", "b.jpg", "B.jpg", "c.jpg"}).disagreements, IsEmpty());
}

TEST_F(PictureMatch, OnePictureForTwoLightsIsRefused) {
  for (const std::string& name : {std::string("sub/a.jpg"), std::string("A.jpg"),
                                  std::string("./a.jpg"), std::string("C:\\a.jpg")}) {
    EXPECT_THAT(of({"a.jpg", name}).refusal, HasSubstr("are one picture")) << name;
  }
  fs::create_symlink("a.jpg", files_.in() / "link.jpg");
  EXPECT_THAT(of({"a.jpg", "link.jpg"}).refusal, HasSubstr("are one picture"));
  EXPECT_THAT(of({"a.jpg", "a.jpg"}).refusal, HasSubstr("listed twice"));
}

TEST_F(PictureMatch, AnotherEndingIsAnotherPicture) {
  EXPECT_THAT(of({"a.tif", "b.jpg", "c.jpg"}).refusal,
              AllOf(HasSubstr("a.tif"), HasSubstr("is it \"a.jpg\"")));
}

TEST_F(PictureMatch, PicturesThatNoLightHasAreSaid) {
  const Match m = of({"a.jpg", "c.jpg"});
  EXPECT_THAT(m.disagreements,
              ElementsAre(AllOf(HasSubstr("a picture of"), HasSubstr("b.jpg"))));
  EXPECT_THAT(of({"a.jpg", "c.jpg"}, {.is_strict = true}).refusal, HasSubstr("b.jpg"));
  EXPECT_THAT(of({"a.jpg", "c.jpg"}, {.exclude = {"b"}}).disagreements, IsEmpty());
  EXPECT_THAT(of({"a.jpg", "c.jpg"}, {.dark = {"b.jpg"}}).disagreements, IsEmpty());
}

TEST_F(PictureMatch, AnotherCountIsSaid) {
  for (const int announced : {1, 2, 4, 100}) {
    const Match m = of({"a.jpg", "b.jpg", "c.jpg"}, {}, announced);
    EXPECT_THAT(m.paths.size(), 3U);
    EXPECT_THAT(
        m.disagreements,
        ElementsAre(HasSubstr(fmt::format("l.lp:1: {} lights announced, 3", announced))));
    EXPECT_THAT(of({"a.jpg", "b.jpg", "c.jpg"}, {.is_strict = true}, announced).refusal,
                HasSubstr("announced"));
  }
}

// A published list counts 47 lights, has 48 lines, and no picture for the last.
TEST_F(PictureMatch, AnUncountedLineWithoutPictureIsLeftOutAndSaid) {
  const std::vector<std::string> four = {"a.jpg", "b.jpg", "c.jpg", "d.jpg"};
  const Match m = of(four, {}, 3);
  EXPECT_THAT(m.paths, ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  EXPECT_THAT(m.disagreements, ElementsAre(HasSubstr("announced"),
                                           AllOf(HasSubstr("d.jpg"), HasSubstr("left"))));
  EXPECT_THAT(of(four, {.is_strict = true}, 3).refusal, HasSubstr("announced"));
  // Counted, or not the last: it is missing.
  EXPECT_THAT(of(four, {}, 4).refusal, HasSubstr("\"d.jpg\" is missing"));
  EXPECT_THAT(of({"a.jpg", "b.jpg", "d.jpg", "c.jpg"}, {}, 3).refusal,
              HasSubstr("\"d.jpg\" is missing"));
  EXPECT_THAT(of({"a.jpg", "d.jpg"}, {}, 1).paths, ElementsAre("in/a.jpg"));
}

TEST_F(PictureMatch, AListWithoutNamesNeedsAsManyPictures) {
  const std::string three = "3\n0 0 1\n0.6 0 0.8\n0 0.6 0.8\n";
  EXPECT_THAT(match(files_, three).paths, ElementsAre("in/a.jpg", "in/b.jpg", "in/c.jpg"));
  EXPECT_THAT(match(files_, "2\n0 0 1\n0.6 0 0.8\n").refusal,
              HasSubstr("3 pictures for 2 lights"));
  files_.add("in/d.jpg");
  EXPECT_THAT(match(files_, three).refusal, HasSubstr("4 pictures for 3 lights"));
  EXPECT_THAT(match(files_, three, {.exclude = {"d"}}).paths.size(), 3U);
  EXPECT_THAT(match(files_, three, {.exclude = {".jpg"}}).refusal,
              HasSubstr("0 pictures for 3"));
}

TEST_F(PictureMatch, TheSameBytesTwiceAreRefused) {
  fs::copy_file(files_.in() / "a.jpg", files_.in() / "b.jpg",
                fs::copy_options::overwrite_existing);
  const std::vector<LightPicture> pictures = {{"a.jpg", files_.in() / "a.jpg"},
                                              {"c.jpg", files_.in() / "c.jpg"},
                                              {"b.jpg", files_.in() / "b.jpg"}};
  try {
    (void)hashes_of_different(pictures, 3);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("b.jpg"), HasSubstr("same bytes as a.jpg")));
  }
  EXPECT_EQ(hashes_of_different(pictures, 2).size(), 3U);  // a dark picture may be any
}

TEST_F(PictureMatch, AFolderThatIsNoneIsNamed) {
  fs::remove_all(files_.in());
  EXPECT_THAT(of({"a.jpg"}).refusal, HasSubstr("cannot be listed"));
}

}  // namespace
}  // namespace haarlight::session
