// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/seen_balls.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector2d;

constexpr double kRivalFraction = 0.25;  // of a picture's brightest value: a highlight

double value_at(ImageView<const float> picture, int y, int x) {
  double sum = 0.0;
  for (int c = 0; c < picture.channels(); ++c) {
    sum += static_cast<double>(picture(y, x, c));
  }
  return sum;
}

double brightest(ImageView<const float> picture) {
  double most = 0.0;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      most = std::max(most, value_at(picture, y, x));
    }
  }
  return most;
}

BallHighlights find_highlights(const LightPictures& pictures,
                               const std::vector<MeasuredBall>& balls) {
  BallHighlights out;
  out.at.resize(static_cast<std::size_t>(pictures.size()));
  out.why.resize(out.at.size());
  pictures.for_each([&](int k, const Image<float>& picture, float /*clip*/) {
    const auto light = static_cast<std::size_t>(k);
    const double most = brightest(picture.view());
    for (const MeasuredBall& ball : balls) {
      std::optional<BallHighlight> found;
      try {
        found = measure_highlight(picture.view(), ball.circle);
        const int x = std::clamp(static_cast<int>(found->at.x()), 0, picture.width() - 1);
        const int y = std::clamp(static_cast<int>(found->at.y()), 0, picture.height() - 1);
        if (value_at(picture.view(), y, x) < kRivalFraction * most) {
          found.reset();
          out.why[light] = "the ball's brightest spot is far below the picture's";
        }
      } catch (const Error& error) {
        out.why[light] = error.problem();
      }
      out.at[light].push_back(found);
    }
  });
  return out;
}

std::vector<MeasuredBall> masked_balls(const CalibratePipelineOptions& options,
                                       const LightPictures& pictures) {
  std::vector<MeasuredBall> out;
  for (const std::filesystem::path& file : options.ball.masks) {
    const PictureFile mask = read_picture(file);
    if (mask.pixels.width() != pictures.width() || mask.pixels.height() != pictures.height()) {
      throw Error(fmt::format("a mask of {} x {} for pictures of {} x {}", mask.pixels.width(),
                              mask.pixels.height(), pictures.width(), pictures.height()),
                  file.string(), "draw the mask on one of the pictures themselves");
    }
    try {
      out.push_back(ball_of_mask(mask.pixels.view()));
    } catch (const Error& error) {
      throw Error(error.problem(), file.string(), error.hint());
    }
  }
  return out;
}

/// @throws Error  circles that rival each other, or a different number of balls than requested
void require_choice(const BallChoice& choice, const std::vector<MeasuredBall>& circles,
                    const CalibratePipelineOptions& options) {
  const std::string hint =
      "paint each ball white and the rest black on one of the pictures, and name it: --ball "
      "MASK.png, once for each ball";
  if (!choice.rivals.empty()) {
    throw Error("which is the ball? " + circle_text(circles[choice.balls.front()].circle) +
                    ", or " + circle_text(circles[choice.rivals.front()].circle),
                options.input.string(), hint);
  }
  if (static_cast<int>(choice.balls.size()) != options.ball.n_balls) {
    std::string text = choice.balls.empty()
                           ? fmt::format(
                                 "no mirror ball is seen ({} circles without a moving "
                                 "highlight)",
                                 circles.size())
                           : fmt::format("{} mirror balls are seen, not {}",
                                         choice.balls.size(), options.ball.n_balls);
    for (const std::size_t i : choice.balls) {
      text += "; " + circle_text(circles[i].circle);
    }
    throw Error(text, options.input.string(),
                choice.balls.empty() ? hint : "say how many there are: --balls N; or " + hint);
  }
}

}  // namespace

BallEvidence evidence_of(const BallHighlights& highlights, std::size_t ball) {
  BallEvidence out;
  Vector2d sum = Vector2d::Zero();
  for (const auto& of_light : highlights.at) {
    if (of_light[ball]) {
      sum += of_light[ball]->at;
      ++out.n_highlights;
    }
  }
  double squares = 0.0;
  for (const auto& of_light : highlights.at) {
    if (of_light[ball]) {
      squares += (of_light[ball]->at - sum / out.n_highlights).squaredNorm();
    }
  }
  out.wander_px = std::sqrt(squares / std::max(out.n_highlights, 1));
  return out;
}

std::string circle_text(const PictureCircle& circle) {
  return fmt::format("a circle about ({:.1f}, {:.1f}) of radius {:.1f}", circle.x, circle.y,
                     circle.radius);
}

SeenBalls see_balls(const CalibratePipelineOptions& options, const LightPictures& pictures) {
  SeenBalls out;
  BallPictures all;
  pictures.for_each(
      [&](int /*k*/, const Image<float>& picture, float /*clip*/) { all.add(picture.view()); });
  out.mean = all.mean();
  if (!options.ball.masks.empty()) {
    out.balls = masked_balls(options, pictures);
    out.highlights = find_highlights(pictures, out.balls);
    return out;
  }
  const std::vector<MeasuredBall> circles = find_circles(out.mean.view());
  const BallHighlights highlights = find_highlights(pictures, circles);
  std::vector<BallEvidence> evidence;
  for (std::size_t i = 0; i < circles.size(); ++i) {
    evidence.push_back(evidence_of(highlights, i));
  }
  const BallChoice choice = choose_balls(circles, evidence, pictures.size());
  require_choice(choice, circles, options);
  for (const std::size_t i : choice.balls) {
    out.balls.push_back(circles[i]);
  }
  out.highlights.why = highlights.why;
  for (const auto& of_light : highlights.at) {
    out.highlights.at.emplace_back();
    for (const std::size_t i : choice.balls) {
      out.highlights.at.back().push_back(of_light[i]);
    }
  }
  return out;
}

Image<float> drawn_balls(const SeenBalls& seen) {
  const Image<float>& mean = seen.mean;
  Image<float> out(mean.height(), mean.width(), 3);
  const float most = *std::max_element(mean.pixels().begin(), mean.pixels().end());
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      const float v = mean(y, x) / std::max(most, 1e-12F);
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = 0.7F * std::sqrt(v);  // keeps dark balls before dark walls visible
      }
    }
  }
  const auto dot = [&](double px, double py, int colour) {
    const int x = static_cast<int>(std::floor(px));
    const int y = static_cast<int>(std::floor(py));
    if (x >= 0 && y >= 0 && x < out.width() && y < out.height()) {
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = c == colour ? 1.0F : 0.0F;
      }
    }
  };
  for (const MeasuredBall& ball : seen.balls) {
    const int n = static_cast<int>(8.0 * ball.circle.radius) + 8;
    for (int i = 0; i < n; ++i) {
      const double a = 2.0 * std::numbers::pi * i / n;
      dot(ball.circle.x + ball.circle.radius * std::cos(a),
          ball.circle.y + ball.circle.radius * std::sin(a), 1);
    }
  }
  const int reach = std::max(2, out.width() / 256);
  for (const auto& of_light : seen.highlights.at) {
    for (const std::optional<BallHighlight>& h : of_light) {
      for (int i = -reach; h && i <= reach; ++i) {
        dot(h->at.x() + i, h->at.y(), 0);
        dot(h->at.x(), h->at.y() + i, 0);
      }
    }
  }
  return out;
}

}  // namespace haarlight::relight
