// SPDX-License-Identifier: Apache-2.0
// The last 24 hours of each robot, as this program has seen them: its time online, signal, latency,
// repeats and interruptions, in slots of ten minutes. Pure, bounded, in memory only: the history
// begins when the program starts, and again when the clock is set back.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

namespace slamgw::web {

class Roster;

class History {
 public:
  static constexpr std::int64_t slot_ms = 600'000;
  static constexpr std::size_t slots = 144;
  static constexpr std::int64_t sample_ms = 10'000;  ///< gateways send `numbers` as often
  /// Each takes 2 KiB. Further robots are not recorded.
  static constexpr std::size_t max_robots = 2000;

  /// Reads a gateway's `numbers`. Takes a robot's only from the gateway that the roster has chosen
  /// for it: a gateway that the robot has left goes on to report its own counts.
  void on_numbers(const Roster& roster, std::string_view gateway, std::string_view payload,
                  std::int64_t now_ms);
  /// Takes a sample of the states when one is due. Call often.
  void update(const Roster& roster, std::int64_t now_ms);

  /// Returns {"robot", "from", "slot_ms", "online": [percent], "rssi_dbm", "latency_us", "repeats",
  /// "gaps"}: a value or null for each slot. The first slot is the oldest known one.
  std::string text(std::string_view robot, std::int64_t now_ms) const;
  std::size_t size() const { return days_.size(); }

 private:
  struct Slot {
    std::uint8_t known = 0;  ///< samples in which a gateway knew the robot's state
    std::uint8_t online = 0;
    std::int8_t rssi_dbm = 0;   ///< the newest; 0: none
    std::uint16_t repeats = 0;  ///< in this slot, as `gaps`
    std::uint16_t gaps = 0;
    std::uint32_t latency_us = 0;  ///< the newest median; 0: none
  };
  struct Day {
    std::array<Slot, slots> ring{};
    std::int64_t newest = 0;  ///< the slot's number, counted from 1970
    std::int64_t oldest = 0;
    std::int64_t alive_ms = 0;
    std::string gateway{};                   ///< which reported the counts below
    std::optional<std::uint64_t> repeats{};  ///< the last count since the gateway started
    std::optional<std::uint64_t> gaps{};
  };

  static Slot& slot_at(Day& day, std::int64_t now_ms);
  Day* day_of(std::string_view robot, std::int64_t now_ms);

  std::map<std::string, Day, std::less<>> days_;
  std::int64_t sampled_ms_ = 0;
};

}  // namespace slamgw::web
