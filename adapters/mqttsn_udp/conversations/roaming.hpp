// SPDX-License-Identifier: Apache-2.0
// Robots that come from another gateway (docs/fleet.md). A CONNECT that resumes a session which is
// not here waits for the note about it, and is then handled like any CONNECT. Messages for the
// robot wait with it.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"
#include "adapters/mqttsn_udp/conversations/sleep.hpp"

namespace slamgw::mqttsn {

class Roaming : Conversation {
 public:
  struct WaitingConnect {
    Arrival arrival;
    Connect connect;
    std::string robot;
    TimePoint until{};
    std::vector<std::pair<TimePoint, RobotMessage>> messages{};  ///< with the time when each came
    /// Removes and returns the messages, each with the time that it has waited.
    std::vector<RobotMessage> take_messages(TimePoint now);
  };
  /// Whether another gateway serves the robot, or has served it.
  using ServedElsewhere = std::function<bool(const std::string& robot)>;

  explicit Roaming(const Conversation& common) : Conversation(common) {}

  void ask(ServedElsewhere served_elsewhere) { served_elsewhere_ = std::move(served_elsewhere); }
  /// Returns true if the CONNECT waits, because the client's session may be at another gateway. The
  /// client's next CONNECT takes its place, from whichever address. One of another client from its
  /// address is dropped.
  bool takes(const Arrival& arrival, const Connect& connect);
  /// Returns true if the message waits with its robot's CONNECT.
  bool keep(const RobotMessage& message, TimePoint now);
  /// Call when the daemon stops: no message waits any longer. Removes and returns those that did.
  std::vector<RobotMessage> on_stop(TimePoint now);
  bool is_waiting(const std::string& robot) const;
  /// Removes and returns the robot's CONNECT, if one waits.
  std::optional<WaitingConnect> take(const std::string& robot);
  /// Removes and returns a CONNECT whose note did not come in time.
  std::optional<WaitingConnect> take_overdue(TimePoint now);
  std::optional<TimePoint> deadline() const;

 private:
  ServedElsewhere served_elsewhere_ = [](const std::string&) { return false; };
  bool is_stopping_ = false;
  std::deque<WaitingConnect> waiting_;  // in the order they came; at most max_waiting_connects
};

/// Reports the note with which another gateway can continue a session, also one that began clean: a
/// CONNECT with CleanSession 0 resumes it while it lasts (R36). A note is written at once, because
/// the robot may go to its next gateway just after a change.
class Notes : Conversation {
 public:
  explicit Notes(const Conversation& common) : Conversation(common) {}

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  void update(ClientSession& session, TimePoint now);
};

/// Turns sessions into snapshots and restores them: over a restart of the daemon, or from another
/// gateway's note (R47; docs/topics.md, promise 7).
class Restoring : Conversation {
 public:
  Restoring(const Conversation& common, Subscriptions& subscriptions, Downlink& downlink,
            Lifecycle& lifecycle, Supervision& supervision)
      : Conversation(common),
        subscriptions_(subscriptions),
        downlink_(downlink),
        lifecycle_(lifecycle),
        supervision_(supervision) {}

  /// Returns nothing if there is no such session.
  std::optional<SessionSnapshot> snapshot(const std::string& client_id, TimePoint now) const;
  /// Continues the session; the client notices nothing. Returns false, and refuses its commands, if
  /// it is known already, there is no room, or its client id or address is now another robot's.
  bool restore(const SessionSnapshot& snapshot, TimePoint now);
  /// Completes a session that began before the former gateway's note could be read. `note`:
  /// nothing when there is none.
  void complete(ClientSession& session, const std::optional<SessionSnapshot>& note, TimePoint now);

  /// Stands for the hash of a note that the broker may not have any more: one from before a
  /// restart, or from before another gateway held the robot's session.
  static constexpr std::uint64_t unknown_note_hash = 1;

 private:
  void refuse_commands(const SessionSnapshot& snapshot, TimePoint now);

  Subscriptions& subscriptions_;
  Downlink& downlink_;
  Lifecycle& lifecycle_;
  Supervision& supervision_;
};

/// Renames robots when the configuration gives them other names while their clients are connected.
/// Each session goes on under the new name, unnoticed by its client.
class Renaming : Conversation {
 public:
  Renaming(const Conversation& common, Subscriptions& subscriptions, Lifecycle& lifecycle)
      : Conversation(common), subscriptions_(subscriptions), lifecycle_(lifecycle) {}

  /// Call when NameRules has new names. Disconnects a client whose id is now another robot's name.
  void on_names(TimePoint now);

 private:
  /// A session and the new name of its robot.
  struct Renamed {
    ClientSession* session = nullptr;
    std::string robot;
  };

  void leave_name(ClientSession& session, TimePoint now);
  void enter_name(const Renamed& renamed, TimePoint now);

  Subscriptions& subscriptions_;
  Lifecycle& lifecycle_;
};

}  // namespace slamgw::mqttsn
