// SPDX-License-Identifier: Apache-2.0
#include "core/picture/chessboard.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

constexpr const char* kWhere = "chessboard";
constexpr double kHalf = 0.5;  // our pixel centres minus OpenCV's

std::vector<cv::Point3f> board_points(const Chessboard& board) {
  std::vector<cv::Point3f> points;
  for (int i = 0; i < board.n_corners(); ++i) {
    const Eigen::Vector3d p = board.corner(i);
    points.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0F);
  }
  return points;
}

std::vector<cv::Point2f> to_cv(std::span<const Eigen::Vector2d> corners,
                               const Chessboard& board) {
  if (corners.size() != static_cast<std::size_t>(board.n_corners())) {
    throw Error(fmt::format("{} corners, the board has {}", corners.size(), board.n_corners()),
                kWhere, "give every inner corner, row by row");
  }
  std::vector<cv::Point2f> out;
  for (const Eigen::Vector2d& c : corners) {
    out.emplace_back(static_cast<float>(c.x() - kHalf), static_cast<float>(c.y() - kHalf));
  }
  return out;
}

cv::Mat camera_matrix(const CameraModel& camera) {
  return (cv::Mat_<double>(3, 3) << camera.fx, 0, camera.cx - kHalf, 0, camera.fy,
          camera.cy - kHalf, 0, 0, 1);
}

cv::Mat distortion(const CameraModel& camera) {
  cv::Mat out(1, 5, CV_64F);
  for (int i = 0; i < 5; ++i) {
    out.at<double>(0, i) = camera.distortion[i];
  }
  return out;
}

std::vector<Eigen::Vector2d> misses(const std::vector<cv::Point2f>& found,
                                    const std::vector<cv::Point2f>& expected) {
  std::vector<Eigen::Vector2d> out;
  for (std::size_t i = 0; i < found.size(); ++i) {
    out.emplace_back(static_cast<double>(found[i].x) - static_cast<double>(expected[i].x),
                     static_cast<double>(found[i].y) - static_cast<double>(expected[i].y));
  }
  return out;
}

double rms(const std::vector<Eigen::Vector2d>& all) {
  double sum = 0.0;
  for (const Eigen::Vector2d& miss : all) {
    sum += miss.squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(all.size(), 1)));
}

/// n and d of the board's plane, as four numbers.
Eigen::Vector4d plane_of(const Eigen::Matrix<double, 6, 1>& pose) {
  cv::Mat turn;
  cv::Rodrigues(cv::Vec3d(pose[0], pose[1], pose[2]), turn);
  Eigen::Vector3d n(turn.at<double>(0, 2), turn.at<double>(1, 2), turn.at<double>(2, 2));
  const Eigen::Vector3d t = pose.tail<3>();
  if (n.dot(t) > 0.0) {
    n = -n;  // towards the camera
  }
  Eigen::Vector4d plane;
  plane << n, -n.dot(t);
  return plane;
}

}  // namespace

std::optional<std::vector<Eigen::Vector2d>> find_chessboard(ImageView<const float> picture,
                                                            const Chessboard& board) {
  HAARLIGHT_EXPECTS(board.rows >= 3 && board.cols >= 3, "a board of 3 x 3 corners or more");
  cv::Mat grey(picture.height(), picture.width(), CV_8U);
  float most = 0.0F;
  const auto value = [&](int y, int x) {
    float sum = 0.0F;
    for (int c = 0; c < picture.channels(); ++c) {
      sum += picture(y, x, c);
    }
    return sum;
  };
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      most = std::max(most, value(y, x));
    }
  }
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      const float fraction = most > 0.0F ? std::max(value(y, x), 0.0F) / most : 0.0F;
      grey.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(std::lround(255.0F * fraction));
    }
  }
  std::vector<cv::Point2f> corners;
  if (!cv::findChessboardCorners(grey, cv::Size(board.cols, board.rows), corners,
                                 cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE)) {
    return std::nullopt;
  }
  // The window stays within the squares: half the smallest distance between neighbours.
  double least = 1e9;
  for (std::size_t i = 0; i + 1 < corners.size(); ++i) {
    least = std::min(least, cv::norm(corners[i + 1] - corners[i]));
  }
  const int half = std::clamp(static_cast<int>(0.4 * least), 2, 11);
  cv::cornerSubPix(grey, corners, cv::Size(half, half), cv::Size(-1, -1),
                   cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 60, 1e-4));
  std::vector<Eigen::Vector2d> out;
  out.reserve(corners.size());
  for (const cv::Point2f& c : corners) {
    out.emplace_back(static_cast<double>(c.x) + kHalf, static_cast<double>(c.y) + kHalf);
  }
  return out;
}

CameraFit fit_camera(std::span<const std::vector<Eigen::Vector2d>> views,
                     const Chessboard& board, int width, int height, bool has_k3) {
  if (views.size() < 3) {
    throw Error(fmt::format("{} pictures of the board", views.size()), kWhere,
                "take at least 3, better 15, with the board tilted differently in each");
  }
  std::vector<std::vector<cv::Point2f>> corners;
  for (const std::vector<Eigen::Vector2d>& view : views) {
    corners.push_back(to_cv(view, board));
  }
  const std::vector<std::vector<cv::Point3f>> points(views.size(), board_points(board));
  cv::Mat k;
  cv::Mat dist;
  std::vector<cv::Mat> turns;
  std::vector<cv::Mat> shifts;
  cv::Mat sigma;
  cv::Mat sigma_pose;
  cv::Mat per_view;
  CameraFit fit;
  try {
    fit.rms_px = cv::calibrateCamera(
        points, corners, cv::Size(width, height), k, dist, turns, shifts, sigma, sigma_pose,
        per_view, has_k3 ? 0 : cv::CALIB_FIX_K3,
        cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 200, 1e-12));
  } catch (const cv::Exception& error) {
    throw Error(fmt::format("the camera cannot be found from these pictures ({})", error.err),
                kWhere, "tilt the board differently in each picture, by 20 to 40 degrees");
  }
  fit.camera.width = width;
  fit.camera.height = height;
  fit.camera.fx = k.at<double>(0, 0);
  fit.camera.fy = k.at<double>(1, 1);
  fit.camera.cx = k.at<double>(0, 2) + kHalf;
  fit.camera.cy = k.at<double>(1, 2) + kHalf;
  for (int i = 0; i < 5; ++i) {
    fit.camera.distortion[i] = dist.at<double>(i);
  }
  for (int i = 0; i < 9; ++i) {
    fit.sigma[i] = sigma.at<double>(i);
  }
  if (!std::isfinite(fit.rms_px) || !fit.sigma.allFinite() || !(fit.camera.fx > 0.0)) {
    throw Error("the pictures do not determine the camera", kWhere,
                "tilt the board differently in each picture, by 20 to 40 degrees");
  }
  for (std::size_t i = 0; i < views.size(); ++i) {
    std::vector<cv::Point2f> expected;
    cv::projectPoints(points[i], turns[i], shifts[i], k, dist, expected);
    fit.misses_px.push_back(misses(corners[i], expected));
    fit.view_rms_px.push_back(rms(fit.misses_px.back()));
  }
  return fit;
}

PlaneFit fit_plane(const CameraModel& camera, std::span<const Eigen::Vector2d> corners,
                   const Chessboard& board) {
  const std::vector<cv::Point2f> found = to_cv(corners, board);
  const std::vector<cv::Point3f> points = board_points(board);
  const cv::Mat k = camera_matrix(camera);
  const cv::Mat dist = distortion(camera);
  cv::Mat turn;
  cv::Mat shift;
  if (!cv::solvePnP(points, found, k, dist, turn, shift)) {
    throw Error("the board's pose cannot be found", kWhere, "take the picture less edge on");
  }
  cv::solvePnPRefineLM(points, found, k, dist, turn, shift);
  std::vector<cv::Point2f> expected;
  cv::Mat jacobian;
  cv::projectPoints(points, turn, shift, k, dist, expected, jacobian);
  PlaneFit fit;
  fit.misses_px = misses(found, expected);
  fit.rms_px = rms(fit.misses_px);
  Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
  for (int row = 0; row < jacobian.rows; ++row) {
    Eigen::Matrix<double, 6, 1> j;
    for (int c = 0; c < 6; ++c) {
      j[c] = jacobian.at<double>(row, c);
    }
    information += j * j.transpose();
  }
  // rms counts both coordinates of a corner; six numbers were fitted to them.
  const double n = 2.0 * static_cast<double>(found.size());
  const double variance = fit.rms_px * fit.rms_px * (0.5 * n) / std::max(n - 6.0, 1.0);
  const Eigen::Matrix<double, 6, 6> covariance = variance * information.inverse();
  Eigen::Matrix<double, 6, 1> pose;
  for (int c = 0; c < 3; ++c) {
    pose[c] = turn.at<double>(c);
    pose[3 + c] = shift.at<double>(c);
  }
  const Eigen::Vector4d plane = plane_of(pose);
  fit.n_cam = plane.head<3>();
  fit.d_mm = plane[3];
  Eigen::Matrix<double, 4, 6> slope;
  for (int c = 0; c < 6; ++c) {
    Eigen::Matrix<double, 6, 1> moved = pose;
    const double h = c < 3 ? 1e-6 : 1e-4;
    moved[c] += h;
    slope.col(c) = (plane_of(moved) - plane) / h;
  }
  const Eigen::Matrix4d of_plane = slope * covariance * slope.transpose();
  fit.distance_sigma_mm = std::sqrt(std::max(of_plane(3, 3), 0.0));
  // n moves at right angles to itself: the largest of its variances.
  const Eigen::Vector3d a = fit.n_cam.unitOrthogonal();
  const Eigen::Vector3d b = fit.n_cam.cross(a);
  Eigen::Matrix<double, 3, 2> across;
  across << a, b;
  const Eigen::Matrix2d tilt = across.transpose() * of_plane.topLeftCorner<3, 3>() * across;
  const double middle = 0.5 * tilt.trace();
  const double spread = std::sqrt(std::max(middle * middle - tilt.determinant(), 0.0));
  fit.tilt_sigma_deg = std::sqrt(middle + spread) * 180.0 / std::numbers::pi;
  if (!std::isfinite(fit.tilt_sigma_deg) || !(fit.d_mm > 0.0)) {
    throw Error("the board is seen edge on", kWhere, "take the picture from higher up");
  }
  return fit;
}

}  // namespace haarlight
