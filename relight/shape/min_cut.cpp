// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/min_cut.h"

#include <opencv2/core.hpp>
#include <opencv2/imgproc/detail/gcgraph.hpp>

namespace haarlight::relight {

Image<std::uint8_t> best_division(const TwoLabels& costs) {
  const int h = costs.stays.height();
  const int w = costs.stays.width();
  const auto n = static_cast<unsigned>(h) * static_cast<unsigned>(w);
  cv::detail::GCGraph<double> graph(n, 4 * n);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      // The source's side stays: the link to the other side is what is paid.
      const int i = graph.addVtx();
      graph.addTermWeights(i, double{costs.moves(y, x)}, double{costs.stays(y, x)});
    }
  }
  const auto join = [&](int i, int j, float cost) {
    if (cost > 0.0F) {
      graph.addEdges(i, j, double{cost}, double{cost});
    }
  };
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const int i = y * w + x;
      if (x + 1 < w) {
        join(i, i + 1, costs.right(y, x));
      }
      if (y + 1 < h) {
        join(i, i + w, costs.down(y, x));
      }
    }
  }
  graph.maxFlow();
  Image<std::uint8_t> moves(h, w, 1);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      moves(y, x) = graph.inSourceSegment(y * w + x) ? 0 : 1;
    }
  }
  return moves;
}

}  // namespace haarlight::relight
