// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/backoff.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(Backoff, DoublesUpToItsLimitAndStartsAgain) {
  Backoff backoff(500ms, 30s);
  std::chrono::milliseconds expected = 500ms;
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(backoff.next_wait(0.0), expected / 2);
    expected = std::min<std::chrono::milliseconds>(30s, expected * 2);
  }
  backoff.reset();
  EXPECT_LE(backoff.next_wait(0.999), 500ms);
}

}  // namespace
}  // namespace slamgw
