// SPDX-License-Identifier: Apache-2.0
// Waiting in I/O tests: polls a condition until it holds or a generous limit has passed; never a
// fixed sleep.
#pragma once

#include <boost/asio/io_context.hpp>
#include <chrono>
#include <functional>
#include <thread>

namespace slamgw::test {

/// Generous because machines are shared; a passing test never waits for it.
inline constexpr std::chrono::seconds patience{30};

inline bool eventually(const std::function<bool()>& condition,
                       std::chrono::milliseconds limit = patience) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

/// The same while the loop runs.
inline bool eventually(boost::asio::io_context& io, const std::function<bool()>& condition,
                       std::chrono::milliseconds limit = patience) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    if (io.stopped()) io.restart();
    io.run_one_for(std::chrono::milliseconds(5));
  }
  return true;
}

}  // namespace slamgw::test
