// SPDX-License-Identifier: Apache-2.0
// The promises of every run of the outbox, with any failures. No acknowledged message is missing (a
// dead letter is not missing). Messages of each topic that was never refused come in order. A
// message repeats at most once for each interruption.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <map>
#include <set>
#include <string>

#include "tests/delivery/outbox_rig.hpp"

namespace slamgw::test {

/// Numbers rise per topic in the order of submission. `interruptions`: lost links and kills; each
/// may repeat a message once.
inline void expect_promises_kept(const OutboxRig& rig,
                                 const std::map<std::uint64_t, std::string>& topic_of_receipt,
                                 std::size_t interruptions) {
  std::map<std::string, std::map<std::uint64_t, std::size_t>> times;
  for (const auto& [topic, messages] : rig.received) {
    std::set<std::uint64_t> before;
    for (const std::string& text : messages) {
      const std::uint64_t number = std::strtoull(text.c_str(), nullptr, 10);
      const std::size_t count = ++times[topic][number];
      EXPECT_LE(count, 1 + interruptions) << topic << " " << number;
      if (count > 1 || rig.refused_topics.contains(topic)) continue;
      const auto later = before.upper_bound(number);
      EXPECT_TRUE(later == before.end()) << topic << ": " << *later << " before " << number;
      before.insert(number);
    }
  }
  for (const auto& [id, letter] : rig.store.dead_letters) {
    const std::string text(as_text(letter.message.payload));
    const std::size_t count =
        ++times[letter.message.topic][std::strtoull(text.c_str(), nullptr, 10)];
    EXPECT_LE(count, 1 + interruptions) << letter.message.topic << " " << text;
  }
  for (const auto& [receipt, outcomes] : rig.fired) {
    EXPECT_EQ(outcomes.size(), 1u) << "receipt " << receipt;
    if (outcomes.front() == ReceiptOutcome::refused) continue;
    const std::string& topic = topic_of_receipt.at(receipt);
    EXPECT_TRUE(times[topic].contains(receipt))
        << topic << " " << receipt << ": acknowledged, lost";
  }
}

}  // namespace slamgw::test
