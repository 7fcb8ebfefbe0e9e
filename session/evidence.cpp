// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/evidence.h"

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

// Bit 0: FrameEvidence::is_read_back, bit 1: is_picture_proved.
constexpr std::array<std::string_view, 4> kProofWords = {"tag", "read_back", "tag+picture",
                                                         "read_back+picture"};

constexpr std::int64_t kMin64 = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t kMax64 = std::numeric_limits<std::int64_t>::max();
constexpr double kMostSigma = 1e12;
constexpr std::size_t kMostPoints = 64;
constexpr std::int64_t kMaxU32 = std::numeric_limits<std::uint32_t>::max();

std::vector<std::string_view> sync_words() {
  return {to_string(SyncMode::free_run), to_string(SyncMode::light_leads),
          to_string(SyncMode::camera_leads), to_string(SyncMode::controller_leads)};
}

std::vector<std::string_view> meaning_words() {
  return {to_string(TimestampMeaning::start_exposure),
          to_string(TimestampMeaning::start_readout), to_string(TimestampMeaning::end_frame)};
}

double finite(double value) {
  HAARLIGHT_EXPECTS(std::isfinite(value), "evidence in finite numbers");
  return value;
}

nlohmann::ordered_json number_or_null(const std::optional<double>& value) {
  return value ? nlohmann::ordered_json(finite(*value)) : nlohmann::ordered_json(nullptr);
}

/// Nothing when missing, as in older sessions, or null.
std::optional<double> find_number(const JsonValue& value, const char* name, double least,
                                  double most) {
  if (!value.has(name) || value[name].dump() == "null") {
    return std::nullopt;
  }
  return value[name].number(least, most);
}

}  // namespace

std::string evidence_to_json(const FrameEvidence& e) {
  nlohmann::ordered_json json;
  json["kind"] = to_string(e.kind);
  json["pattern_id"] = e.pattern_id;
  json["tag"] = e.tag;
  json["tag_echo"] = e.tag_echo;
  json["light_proof"] =
      kProofWords[(e.is_read_back ? 1U : 0U) + (e.is_picture_proved ? 2U : 0U)];
  json["t_command_ns"] = e.t_command_ns;
  json["t_ack_ns"] = e.t_ack_ns;
  json["t_shown_ns"] = nullptr;
  if (e.t_shown_ns) {
    json["t_shown_ns"] = *e.t_shown_ns;
  }
  json["t_stable_ns"] = e.t_stable_ns;
  json["t_exposure_start_ns"] = e.t_exposure_start_ns;
  json["t_exposure_end_ns"] = e.t_exposure_end_ns;
  json["t_next_change_ns"] = e.t_next_change_ns;
  json["sequence"] = e.sequence;
  json["timestamp_ns"] = e.timestamp_ns;
  json["flags"] = e.flags;
  json["exposure_asked_us"] = finite(e.exposure_requested_us);
  json["exposure_read_us"] = finite(e.exposure_read_us);
  json["gain_db"] = finite(e.gain_db);
  json["read_us"] = finite(e.read_us);
  json["skew_us"] = finite(e.skew_us);
  json["timestamp_meaning"] = to_string(e.timestamp_meaning);
  json["step_before"] = e.step_before;
  json["step_after"] = e.step_after;
  json["margin_us"] = finite(e.margin_us);
  json["discarded_before"] = e.discarded_before;
  json["sync"] = to_string(e.sync);
  json["min_dn"] = e.min_dn;
  json["max_dn"] = e.max_dn;
  json["mean_dn"] = finite(e.mean_dn);
  json["saturated_share"] = finite(e.saturated_fraction);
  json["black_share"] = finite(e.black_fraction);
  json["pixel_hash"] = e.pixel_hash;
  json["verdict"] = to_string(e.verdict);
  json["temperature_c"] = number_or_null(e.temperature_c);
  json["picture_own_sigma"] = number_or_null(e.picture_own_sigma);
  json["picture_other_sigma"] = number_or_null(e.picture_other_sigma);
  json["picture_discrimination_sigma"] = number_or_null(e.picture_discrimination_sigma);
  json["picture_other"] = e.picture_other;
  json["agrees_with"] = e.agrees_with;
  json["other_light_at_most"] = number_or_null(e.other_light_at_most);
  json["picture_points"] = nlohmann::ordered_json::array();
  for (const double value : e.picture_points) {
    json["picture_points"].push_back(finite(value));
  }
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

FrameEvidence evidence_from_json(const std::string& json, const std::string& where) {
  const JsonValue value = JsonValue::parse(json, where);
  FrameEvidence e;
  const std::vector<std::string_view> kinds = {to_string(EvidenceKind::measured),
                                               to_string(EvidenceKind::asserted),
                                               to_string(EvidenceKind::replayed)};
  e.kind = static_cast<EvidenceKind>(value["kind"].choice(kinds));
  e.pattern_id = value["pattern_id"].integer(kMin64, kMax64);
  e.tag = static_cast<std::uint32_t>(value["tag"].integer(0, kMaxU32));
  e.tag_echo = static_cast<std::uint32_t>(value["tag_echo"].integer(0, kMaxU32));
  if (value.has("light_proof")) {  // older sessions always have tags
    const auto proof = value["light_proof"].choice({kProofWords.begin(), kProofWords.end()});
    e.is_read_back = proof % 2 == 1;
    e.is_picture_proved = proof >= 2;
  }
  e.t_command_ns = value["t_command_ns"].integer(kMin64, kMax64);
  e.t_ack_ns = value["t_ack_ns"].integer(kMin64, kMax64);
  if (value.has("t_shown_ns") && value["t_shown_ns"].dump() != "null") {
    e.t_shown_ns = value["t_shown_ns"].integer(kMin64, kMax64);
  }
  e.t_stable_ns = value["t_stable_ns"].integer(kMin64, kMax64);
  e.t_exposure_start_ns = value["t_exposure_start_ns"].integer(kMin64, kMax64);
  e.t_exposure_end_ns = value["t_exposure_end_ns"].integer(kMin64, kMax64);
  e.t_next_change_ns = value["t_next_change_ns"].integer(kMin64, kMax64);
  e.sequence = value["sequence"].unsigned_integer();
  e.timestamp_ns = value["timestamp_ns"].integer(kMin64, kMax64);
  e.flags = static_cast<std::uint32_t>(value["flags"].integer(0, kMaxU32));
  e.exposure_requested_us = value["exposure_asked_us"].number(0.0);
  e.exposure_read_us = value["exposure_read_us"].number(0.0);
  e.gain_db = value["gain_db"].number();
  e.read_us = value["read_us"].number(0.0);
  e.skew_us = value["skew_us"].number(0.0);
  e.timestamp_meaning =
      static_cast<TimestampMeaning>(value["timestamp_meaning"].choice(meaning_words()));
  e.step_before = value["step_before"].integer(-1, kMax64);
  e.step_after = value["step_after"].integer(-1, kMax64);
  e.margin_us = value["margin_us"].number();
  e.discarded_before =
      static_cast<int>(value["discarded_before"].integer(0, std::numeric_limits<int>::max()));
  e.sync = static_cast<SyncMode>(value["sync"].choice(sync_words()));
  e.min_dn = static_cast<std::uint16_t>(value["min_dn"].integer(0, 65535));
  e.max_dn = static_cast<std::uint16_t>(value["max_dn"].integer(0, 65535));
  e.mean_dn = value["mean_dn"].number();
  e.saturated_fraction = value["saturated_share"].number(0.0, 1.0);
  e.black_fraction = value["black_share"].number(0.0, 1.0);
  e.pixel_hash = value["pixel_hash"].text();
  if (value.has("verdict")) {  // sessions of version 0.1 have neither
    e.verdict = value["verdict"].one_of<FrameVerdict>();
  }
  e.temperature_c = find_number(value, "temperature_c", -300.0, 2000.0);
  e.picture_own_sigma = find_number(value, "picture_own_sigma", 0.0, kMostSigma);
  e.picture_other_sigma = find_number(value, "picture_other_sigma", 0.0, kMostSigma);
  e.picture_discrimination_sigma =
      find_number(value, "picture_discrimination_sigma", 0.0, kMostSigma);
  if (value.has("picture_other")) {
    e.picture_other =
        static_cast<int>(value["picture_other"].integer(-1, std::numeric_limits<int>::max()));
  }
  if (value.has("agrees_with")) {
    e.agrees_with =
        static_cast<int>(value["agrees_with"].integer(-1, std::numeric_limits<int>::max()));
    e.other_light_at_most = find_number(value, "other_light_at_most", 0.0, 1.0);
    const std::vector<JsonValue> points = value["picture_points"].elements();
    if (points.size() > kMostPoints) {
      value["picture_points"].refuse("more than 64 points", "is it a haarlight session?");
    }
    for (const JsonValue& point : points) {
      e.picture_points.push_back(point.number());
    }
  }
  return e;
}

}  // namespace haarlight::session
