#include "core/parallel.h"

#include <algorithm>

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include "core/error.h"

namespace haarlight {

void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
  HAARLIGHT_EXPECTS(grain > 0, "a positive grain");
  const std::size_t n_pieces = (count + grain - 1) / grain;
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, n_pieces, 1),
      [&](const tbb::blocked_range<std::size_t>& pieces) {
        for (std::size_t i = pieces.begin(); i != pieces.end(); ++i) {
          body(i * grain, std::min(count, (i + 1) * grain));
        }
      },
      tbb::simple_partitioner());
}

struct ThreadLimit::Impl {
  tbb::global_control control;
};

ThreadLimit::ThreadLimit(int n_threads)
    : impl_(new Impl{tbb::global_control(tbb::global_control::max_allowed_parallelism,
                                         static_cast<std::size_t>(std::max(1, n_threads)))}) {}

ThreadLimit::~ThreadLimit() = default;

}  // namespace haarlight
