// SPDX-License-Identifier: Apache-2.0
// What gateways say to each other, as values and as JSON. Robots' ids stand in the payload only, so
// that no engine stumbles over them; the last level of each topic names the sender, so that a
// broker's access control list can tie it to the user. Pure.
//
//   <prefix>/fleet/all/<sender>           to everybody: Beat and Hears (QoS 0), ClaimRobot,
//                                         AskForSign, Taken, Table
//   <prefix>/fleet/to/<gateway>/<sender>  to one: AskTable, Table, Release, Heard
#pragma once

#include <algorithm>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"
#include "daemon/fleet/claim.hpp"

namespace slamgw::fleet {

/// A larger payload is malformed, whatever is in it.
inline constexpr std::size_t max_payload_octets = 256 * 1024;
/// Rows of one Table message: some 40 kB with long ids.
inline constexpr std::size_t max_table_rows = 500;

/// A sign of life. What came back to its sender is the sender's lease.
struct Beat {
  std::int64_t sent_ms = 0;      ///< the sender's monotonic clock; only differences are used
  std::uint32_t period_ms = 0;   ///< until the next one
  std::uint64_t count = 0;       ///< robots that the sender claims
  std::uint64_t digest = 0;      ///< of its claims: ClaimTable::Digest
  std::uint64_t up_ms = 0;       ///< for how long the sender's life hears the others
  std::uint64_t gapless_ms = 0;  ///< for how long it has missed nothing; not more than `up_ms`
};
/// `from`: the gateway that is to release the robot; empty when nobody has it.
struct ClaimRobot {
  std::string robot;
  std::uint64_t epoch = 0;
  std::string from;
};
/// Before a will is published: has anybody heard this robot in the last `silent_ms`?
struct AskForSign {
  std::string robot;
  std::uint64_t silent_ms = 0;
};
/// The sender alone deals with one copy of this command; said before anything goes on the air.
struct Taken {
  std::uint64_t id = 0;   ///< of the sender's life
  std::uint64_t key = 0;  ///< CommandTurns::key_of
  std::string robot;
  std::string type;
  std::uint64_t age_ms = 0;   ///< since the command came to the sender
  bool is_refusal = false;    ///< the sender takes it only to refuse it, or to tell its outcome
  bool is_ended = false;      ///< the sender has published its outcome, or knows it
  std::int64_t sent_ms = 0;   ///< as Beat::sent_ms, so that `age_ms` counts from then; 0: unknown
  std::uint64_t kept_ms = 0;  ///< the broker may have kept it for the sender for so long before
};
/// A command that somebody has dealt with.
struct DoneCommand {
  std::uint64_t id = 0;
  std::uint64_t key = 0;
  std::string type;
  std::uint64_t age_ms = 0;
};
inline constexpr std::size_t max_taken_commands = 64;
/// Answers a claim: the sender does not serve the robot and makes way for `to`, which may be
/// another claim than the one that is answered.
struct Release {
  std::string robot;
  Claim to;
  Bytes session;                    ///< of the robot at the sender, for the new owner; may be empty
  std::vector<DoneCommand> done{};  ///< of the robot, lately: the receiver may have missed that
  std::int64_t sent_ms = 0;         ///< as in Taken
};
/// Answers AskForSign: the sender has heard the robot since.
struct Heard {
  std::string robot;
};
struct AskTable {};
/// All claims of the sender for robots after `after` up to `upto` in the order of ids; an empty
/// `upto` is the end.
struct Table {
  struct Row {
    std::string robot;
    std::uint64_t epoch = 0;
  };
  std::string after;
  std::string upto;
  std::vector<Row> rows;
};

/// What the sender's board hears in a mesh that boards of other gateways hear, too.
struct Hears {
  /// Nothing is known of the level.
  static constexpr int lowest_level_db = -1000;
  struct Row {
    std::string robot;
    int level_db = lowest_level_db;  ///< SignalLevel
    std::uint64_t age_ms = 0;        ///< since it was heard last
  };
  bool is_board_up = false;
  std::vector<Row> rows;  ///< at most max_table_rows
};

using Body =
    std::variant<Beat, ClaimRobot, AskForSign, Heard, Taken, Release, AskTable, Table, Hears>;

struct FleetMessage {
  std::string sender;
  Life life = 0;
  Body body;
};

/// Beat::sent_ms of what is sent at `time`.
inline std::int64_t to_clock_ms(TimePoint time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
}
inline std::uint64_t to_age_ms(Duration age) {
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::milliseconds>(std::max(age, Duration::zero()))
          .count());
}
/// When it came, by the receiver's clock. A stranger may send any age; an hour counts at most.
inline TimePoint came_before(TimePoint now, std::uint64_t age_ms) {
  constexpr std::uint64_t longest_ms = 3'600'000;
  return now - std::chrono::milliseconds(std::min(age_ms, longest_ms));
}

inline Duration kept_before(const Taken& taken) {
  constexpr std::uint64_t longest_ms = 3'600'000;
  return std::chrono::milliseconds(std::min(taken.kept_ms, longest_ms));
}

std::string encode(Life life, const Body& body);
/// Nothing when the payload is not what this version or a compatible one sends.
std::optional<FleetMessage> decode(std::string_view sender, ByteView payload);

}  // namespace slamgw::fleet
