// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/spare_buffers.hpp"

#include <gtest/gtest.h>

#include <string>

#include "daemon/core/bytes.hpp"

namespace slamgw {
namespace {

using Spare = SpareBuffers<std::string>;

/// Removes the buffers that earlier tests of this thread have left.
void take_all() {
  while (Spare::take().capacity() > std::string().capacity()) {
  }
}

TEST(SpareBuffers, ReusesTheMemoryWithoutTheContent) {
  take_all();
  std::string text(100, 'x');
  const char* const memory = text.data();
  Spare::give_back(std::move(text));
  const std::string next = Spare::take();
  EXPECT_TRUE(next.empty());
  EXPECT_EQ(next.data(), memory);
  EXPECT_GE(next.capacity(), 100u);
}

TEST(SpareBuffers, CopiesWithAndWithoutASpareBuffer) {
  take_all();
  EXPECT_EQ(Spare::copy(std::string("without a spare one, on the heap")),
            "without a spare one, on the heap");
  Spare::give_back(std::string(40, 'x'));
  EXPECT_EQ(Spare::copy(std::string(80, 'y')), std::string(80, 'y'));
  EXPECT_EQ(SpareBuffers<Bytes>::copy(Bytes{1, 2, 3}), (Bytes{1, 2, 3}));
}

TEST(SpareBuffers, KeepsABoundedNumberOfBuffersOfBoundedSize) {
  take_all();
  Spare::give_back(std::string(Spare::max_octets + 1, 'x'));
  Spare::give_back("short");
  EXPECT_EQ(Spare::take().capacity(), std::string().capacity());
  for (std::size_t i = 0; i <= Spare::max_count; ++i) Spare::give_back(std::string(100, 'x'));
  std::size_t kept = 0;
  while (Spare::take().capacity() > std::string().capacity()) ++kept;
  EXPECT_EQ(kept, Spare::max_count);
}

}  // namespace
}  // namespace slamgw
