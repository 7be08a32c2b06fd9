// SPDX-License-Identifier: Apache-2.0
#include "simulation/update_record.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace slamgw::sim {
namespace {

std::string failure_of(const std::string& record, const std::string& trace) {
  try {
    UpdateRecord(record, trace, "thread").write("robot1", {.number = 1, .payload = {1}});
  } catch (const std::runtime_error& failure) {
    return failure.what();
  }
  return "none";
}

/// A record on a full disk looked like a whole one, so messages that got lost were not counted.
TEST(UpdateRecord, NamesFileThatCannotBeWritten) {
  const std::string failure = "/dev/full cannot be written: No space left on device";
  EXPECT_EQ(failure_of("/dev/full", ""), failure);
  EXPECT_EQ(failure_of("", "/dev/full"), failure);
  EXPECT_EQ(failure_of("/", ""), "/ cannot be written: Is a directory");
  EXPECT_EQ(failure_of("/dev/null", "/dev/null"), "none");
}

}  // namespace
}  // namespace slamgw::sim
