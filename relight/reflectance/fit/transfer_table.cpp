// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/transfer_table.h"

namespace haarlight::relight {

TransferTable::TransferTable(Transfer transfer) {
  if (transfer == Transfer::linear) {
    return;
  }
  const auto n = static_cast<std::size_t>(kLast) + 2;
  for (std::size_t i = 0; i < n; ++i) {
    table_.push_back(srgb_from_linear(static_cast<float>(i) / kPerUnit));
  }
}

}  // namespace haarlight::relight
