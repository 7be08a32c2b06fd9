// SPDX-License-Identifier: Apache-2.0
// Measures which robots hear which others, by heartbeats (Mesh Profile 1.0 section 3.6.7). One
// robot after the other publishes heartbeats; the others count them and then report the count. Each
// robot ends both by itself, so nothing has to survive a restart. NodeConversations asks the
// questions. Part of Provisioner.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

class HearingSurvey : private ProvisionerPart {
 public:
  /// Time from the request until the last heartbeat has arrived.
  static constexpr Duration heartbeat_time = std::chrono::seconds{9};
  /// Time of a typical question, for the forecast.
  static constexpr Duration question_time = std::chrono::milliseconds{150};
  /// Unanswered questions in a row after which a robot is not asked again.
  static constexpr unsigned max_misses = 2;
  /// Maximum of requests to publish for a robot that does not answer.
  static constexpr unsigned max_attempts = 3;
  /// Free places that robots' replay lists must still have after each source has taken one.
  static constexpr std::size_t spare_places = 4;

  explicit HearingSurvey(const ProvisionerPart& shared) : ProvisionerPart(shared) {}

  /// Begins a survey unless one is running. Returns why none can begin; else empty.
  std::string begin(TimePoint now);
  bool is_on() const { return state_ == State::running; }
  void on_link_down();

  /// Returns when to ask next; nothing while a question awaits its answer.
  std::optional<TimePoint> due() const;
  /// Returns the robot to ask next.
  std::uint16_t address() const { return at_ < robots_.size() ? robots_[at_].address : 0; }
  /// Returns the question for that robot; empty if it is not due or another robot is next.
  std::vector<ConfigurationStep> next(TimePoint now);
  void on_asked(const NodeConfiguration& question, TimePoint now);

  /// `{"state", "why", "robots", "measured", "seconds_left", "silent": [...], "rows": [{"source",
  /// "listener", "sent", "heard", "heard_at_most", "min_hops", "max_hops"}]}`; "state" is `none`,
  /// `running`, `done` or `failed`. Without relays there is one hop.
  std::string json() const;

 private:
  enum class State : std::uint8_t { none, running, done, failed };
  enum class Phase : std::uint8_t {
    subscribing,  ///< the others get ready to count
    publishing,   ///< the source sends
    counting,     ///< the others report their counts
    closing,      ///< all robots stop both
  };
  struct Robot {
    std::uint16_t address = 0;
    std::string id;
    unsigned misses = 0;     ///< in a row
    bool is_silent = false;  ///< the robot has left a question unanswered
    bool counts = false;     ///< the heartbeats of the present source
  };
  struct Row {
    std::size_t source;
    std::size_t listener;
    HeartbeatCount count;
  };

  bool is_skipped() const;
  void go_on();
  void go_to(Phase phase);
  void go_to_source(std::size_t source);
  std::vector<ConfigurationStep> steps() const;
  void on_published(bool is_answered);
  bool keep_count(const NodeConfiguration& question);

  std::vector<Robot> robots_;
  std::vector<Row> rows_;
  State state_ = State::none;
  std::string why_;
  Phase phase_ = Phase::closing;
  std::size_t source_ = 0;
  std::size_t at_ = 0;  ///< the robot that is asked
  unsigned attempts_ = 0;
  bool is_asking_ = false;
  TimePoint published_at_{};
  TimePoint due_{};
};

}  // namespace slamgw::ble
