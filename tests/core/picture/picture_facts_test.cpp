// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/picture_facts.h"

#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/picture/picture_tags.h"
#include "haarlight/core/picture/image_io.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::IsEmpty;
using testing::TemporaryFolder;

PictureFacts all_facts() {
  return {.orientation = 1,
          .exposure_s = 1.0 / 125.0,
          .f_number = 5.6,
          .iso = 400.0,
          .model = "NIKON D800",
          .taken = "2026:11:22 20:30:21"};
}

/// The reader was written for cameras' files, by the standard, before there was a writer.
PictureFacts through_exif(const PictureFacts& facts) {
  return exif_tags(exif_block(facts)).facts;
}

TEST(PictureFacts, ComeBackFromExif) {
  EXPECT_EQ(through_exif(all_facts()), all_facts());
  for (const char* model : {"", "D", "D80", "D800", "D8000", "a model of some 30 characters"}) {
    PictureFacts facts = all_facts();
    facts.model = model;
    EXPECT_EQ(through_exif(facts), facts) << model;
  }
  PictureFacts facts;
  facts.taken = "2026:11:22 20:30:21";
  EXPECT_EQ(through_exif(facts), facts);
  EXPECT_THAT(exif_block({.orientation = 6, .model = {}, .taken = {}}), IsEmpty());
}

TEST(PictureFacts, NumbersComeBackAsCamerasWriteThem) {
  for (const double time : {1.0 / 8000.0, 1.0 / 3.0, 0.3, 0.625, 1.3, 30.0, 600.0, 1e6, 1e-6}) {
    PictureFacts facts;
    facts.exposure_s = time;
    EXPECT_EQ(through_exif(facts).exposure_s, time);
  }
  // What EXIF cannot hold is left out, not changed.
  for (const double time : {0.0, -1.0, 1e-7, 1e300, std::nan(""), HUGE_VAL}) {
    PictureFacts facts;
    facts.exposure_s = time;
    EXPECT_FALSE(through_exif(facts).exposure_s) << time;
  }
  PictureFacts pi;
  pi.exposure_s = 3.14159265358979;
  EXPECT_NEAR(through_exif(pi).exposure_s.value(), *pi.exposure_s, 1e-11);  // 1 / 10^6 squared
  for (const double iso : {0.5, 65535.0, 102400.0}) {
    PictureFacts facts;
    facts.iso = iso;
    EXPECT_FALSE(through_exif(facts).iso) << iso;
  }
}

TEST(PictureFacts, OfASetAreWhatAllItsPicturesTell) {
  PictureFacts later = all_facts();
  later.taken = "2026:11:22 20:30:29";
  later.exposure_s = 1.0 / 60.0;
  later.orientation = 6;
  PictureFacts silent;
  PictureFacts expected = all_facts();
  expected.exposure_s.reset();
  EXPECT_EQ(common_facts(std::vector{later, all_facts()}), expected);
  EXPECT_EQ(common_facts(std::vector{all_facts(), later}), expected);
  expected = PictureFacts();
  expected.taken = later.taken;
  EXPECT_EQ(common_facts(std::vector{silent, later}), expected);
  EXPECT_EQ(common_facts(std::vector{later, silent}), expected);
  EXPECT_FALSE(has_facts(common_facts({})));
}

/// A fact that the first two tell differently does not come back with the third.
TEST(PictureFacts, OnceApartStayApart) {
  std::vector<PictureFacts> pictures(3, all_facts());
  pictures[1].iso = 100.0;
  pictures[2].iso.reset();
  EXPECT_FALSE(common_facts(pictures).iso);
  pictures[1].iso.reset();
  pictures[2].iso = 100.0;
  EXPECT_FALSE(common_facts(pictures).iso);
  pictures[1].model = "";
  EXPECT_EQ(common_facts(pictures).model, "");
}

TEST(PictureFacts, AreReadableWords) {
  EXPECT_EQ(words_of(all_facts()), "NIKON D800, 1/125 s, f/5.6, ISO 400, 2026-11-22 20:30:21");
  PictureFacts facts;
  facts.exposure_s = 2.5;
  facts.taken = "?";
  EXPECT_EQ(words_of(facts), "2.5 s, ?");
  EXPECT_EQ(words_of(PictureFacts()), "");
}

TEST(PictureFacts, AreInWrittenPngsAndExrs) {
  const TemporaryFolder folder;
  const Image<float> image(4, 5, 3);
  for (const char* name : {"a.png", "a.exr"}) {
    write_image(folder / name, image.view(), 1.0,
                {.texts = {{"haarlightRoot", "0123abcd"}}, .facts = all_facts()});
    PictureFacts found = read_picture_facts(folder / name);
    // OpenEXR's attributes are floats.
    EXPECT_NEAR(found.exposure_s.value(), 1.0 / 125.0, 1e-9);
    EXPECT_NEAR(found.f_number.value(), 5.6, 1e-6);
    found.exposure_s = all_facts().exposure_s;
    found.f_number = all_facts().f_number;
    EXPECT_EQ(found, all_facts()) << name;
    write_image(folder / name, image.view());
    EXPECT_FALSE(has_facts(read_picture_facts(folder / name))) << name;
  }
}

}  // namespace
}  // namespace haarlight
