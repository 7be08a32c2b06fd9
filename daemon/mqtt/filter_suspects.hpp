// SPDX-License-Identifier: Apache-2.0
// Which SUBSCRIBE a broker may have closed the connection for: Mosquitto does so for a control
// character and for more than 200 levels, others for filters that they forbid. What was unanswered
// at two losses in a row is tried alone, before anything else uses the new connection; a filter
// that loses the connection alone twice is set aside for an hour. Pure; part of Upstream.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw {

/// A subscription as Upstream is asked for it.
struct WantedSubscription {
  std::string filter;
  Qos qos = Qos::at_most_once;
  std::uint32_t id = 0;
};

class FilterSuspects {
 public:
  /// Losses in a row that make an unanswered filter a suspect; a filter that this broker has
  /// answered before needs more.
  static constexpr unsigned losses_of_new = 2;
  static constexpr unsigned losses_of_answered = 4;
  static constexpr unsigned losses_alone = 2;
  /// Two losses that lie further apart have nothing to do with each other. As long is a filter set
  /// aside: the broker may have changed.
  static constexpr std::chrono::hours memory{1};
  /// Bounds what robots with ever new filters can make this remember; the oldest goes.
  static constexpr std::size_t most_aside = 1000;
  /// How long the connection waits for the answers in a trial.
  static constexpr std::chrono::seconds trial_timeout{5};

  /// It went to the broker.
  void on_sent(const WantedSubscription& subscription);
  void on_answered(const std::string& filter);
  /// Nobody wants it any more, or the broker has refused it.
  void forget(const std::string& filter);
  /// The connection is lost. The filter that is set aside for it.
  std::optional<std::string> on_lost(TimePoint now);

  bool has_unanswered() const;
  bool has_suspects() const;
  bool is_aside(const std::string& filter, TimePoint now);
  /// The suspect to be sent next, alone; nothing: the connection is free for everybody.
  std::optional<WantedSubscription> next_trial();
  /// No answer came in time, and the connection stands: there is nothing to hold against anybody.
  void acquit_all();

 private:
  struct Record {
    Qos qos = Qos::at_most_once;
    std::uint32_t id = 0;
    bool is_under_way = false;
    bool was_answered = false;
    unsigned losses = 0;
    unsigned losses_alone = 0;
    bool is_suspect() const {
      return losses >= (was_answered ? losses_of_answered : losses_of_new);
    }
  };

  void set_aside(const std::string& filter, TimePoint now);

  std::map<std::string, Record> records_;   // of the filters that are wanted
  std::map<std::string, TimePoint> aside_;  // until when
  std::optional<std::string> on_trial_;
  TimePoint last_loss_{};
};

}  // namespace slamgw
