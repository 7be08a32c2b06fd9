// SPDX-License-Identifier: Apache-2.0
// What one page may do: it watches until it has sent the token, then it may send commands, so many
// a second. Pure: texts and `now` in, a reaction out.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>

#include "web/server/mirror.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

class PageSession {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  /// Guessing must not be quick: the connection ends after so many wrong tokens.
  static constexpr unsigned max_wrong_tokens = 3;
  /// Fast enough for a person and a script; a page gone wild must not flood a mesh.
  static constexpr double commands_per_second = 20;
  static constexpr double command_burst = 40;

  /// `token`: empty when nobody may send. Both must outlive the session.
  PageSession(const Topics& topics, const std::string& token) : topics_(topics), token_(token) {}

  struct Reaction {
    std::string reply;  ///< for the page; empty: none
    std::optional<CommandRequest> publish{};
    bool ends = false;  ///< the connection, after the reply
  };
  Reaction on_text(std::string_view text, TimePoint now);

 private:
  Reaction on_token(const TokenOffer& offer);
  Reaction on_command(CommandRequest command, TimePoint now);
  bool take_turn(TimePoint now);

  const Topics& topics_;
  const std::string& token_;
  bool may_send_ = false;
  unsigned wrong_tokens_ = 0;
  double turns_ = command_burst;
  std::optional<TimePoint> turns_at_{};
};

/// {"topic": "$web/refused", "payload": {"topic", "why"}}
std::string refusal(std::string_view topic, std::string_view why);

}  // namespace slamgw::web
