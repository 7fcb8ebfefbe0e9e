// SPDX-License-Identifier: Apache-2.0
#include "apps/serve/picture_request.h"

#include <charconv>
#include <cmath>
#include <string_view>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

constexpr const char* kCure = "docs/reference/serve.md tells what a picture may be asked for";

double number(const std::string& name, const std::string& text, double least, double most) {
  double value = 0.0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    throw Error(fmt::format("\"{}\" is no number", text), name, kCure);
  }
  if (value < least || value > most) {
    throw Error(fmt::format("{} is not between {} and {}", text, least, most), name, kCure);
  }
  return value;
}

int whole_number(const std::string& name, const std::string& text) {
  int value = 0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size() || value < 0) {
    throw Error(fmt::format("\"{}\" is no whole number from 0", text), name, kCure);
  }
  return value;
}

relight::TermOrder term_order(const std::string& name, const std::string& text) {
  const auto order = value_of<relight::TermOrder>(text);
  if (!order) {
    throw Error(fmt::format("there is no order \"{}\"", text), name,
                "write transport or light");
  }
  return *order;
}

}  // namespace

PictureRequest picture_request(const http::HttpRequest& request) {
  PictureRequest asked;
  for (const auto& [name, text] : request.query) {
    if (name == "lights") {
      asked.lights = text;
    } else if (name == "sky") {
      asked.sky = text;
    } else if (name == "rotate") {
      asked.rotate_deg = number(name, text, -1e6, 1e6);
    } else if (name == "max_error") {
      asked.terms.max_error = number(name, text, 0.0, 1.0);
    } else if (name == "terms") {
      asked.terms.terms = whole_number(name, text);
    } else if (name == "order") {
      asked.terms.order = term_order(name, text);
    } else if (name == "exposure") {
      asked.display.exposure = number(name, text, 0.0, 1e30);
    } else if (name == "stops") {
      asked.display.stops = number(name, text, -60.0, 60.0);
    } else {
      throw Error(fmt::format("a picture cannot be asked for \"{}\"", name), request.path,
                  "ask for lights, sky, rotate, max_error, terms, order, exposure, stops");
    }
  }
  if (asked.terms.terms && asked.terms.max_error) {
    throw Error("terms and max_error at once", request.path, "ask for one of them");
  }
  if (asked.rotate_deg != 0.0 && !asked.sky) {
    throw Error("rotate turns a sky, and none is named", request.path, "name a sky");
  }
  return asked;
}

}  // namespace haarlight::apps
