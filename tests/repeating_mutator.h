// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

/// @file
/// A mutation that libFuzzer's own never come to: a short piece of the input repeated up to the
/// length limit ("a.a.a...", "[[[[", "{a={a="). For the one .cpp of a fuzzer of texts.

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size,
                                        std::size_t max_size);

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size,
                                               std::size_t max_size, unsigned int seed) {
  constexpr unsigned kOneIn = 32;  // long inputs are slow
  std::minstd_rand random(seed);
  if (size == 0 || random() % kOneIn != 0) {
    return LLVMFuzzerMutate(data, size, max_size);
  }
  const std::size_t at = random() % size;
  const std::size_t n = 1 + random() % std::min<std::size_t>(size - at, 16);
  const std::vector<std::uint8_t> piece(data + at, data + at + n);
  const std::vector<std::uint8_t> rest(data + at + n, data + size);
  const std::size_t room = max_size - std::min(max_size, at + rest.size());
  const std::size_t n_times = 1 + random() % std::max<std::size_t>(room / n, 1);
  std::size_t end = at;
  for (std::size_t i = 0; i < n_times && end + n <= max_size; ++i, end += n) {
    std::memcpy(data + end, piece.data(), n);
  }
  const std::size_t n_rest = std::min(rest.size(), max_size - end);
  if (n_rest > 0) {
    std::memcpy(data + end, rest.data(), n_rest);
  }
  return end + n_rest;
}
