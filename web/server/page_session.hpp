// SPDX-License-Identifier: Apache-2.0
// What one page may do: it watches until it has sent the token, then it may send commands, so many
// a second. Pure: texts and `now` in, a reaction out.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "web/server/client_counts.hpp"
#include "web/server/mirror.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

class PageSession {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  /// Guessing must not be quick: the connection ends after so many wrong tokens.
  static constexpr unsigned max_wrong_tokens = 3;
  /// Each connection counts its own, so answers to more wrong tokens of one client come late. A
  /// person who mistypes a token does not notice.
  static constexpr unsigned prompt_answers = 5;
  static constexpr std::chrono::seconds first_delay{1};  ///< doubles with each wrong token
  /// An address has eight pages, each of which tries two tokens in this time.
  static constexpr std::chrono::seconds longest_delay{30};
  /// Fast enough for a person and a script; a page gone wild must not flood a mesh.
  static constexpr double commands_per_second = 20;
  static constexpr double command_burst = 40;

  /// `token`: empty when nobody may send. `guesses`: wrong tokens of all clients. The references
  /// must outlive the session.
  PageSession(const Topics& topics, const std::string& token, ClientCounts& guesses, Client client)
      : topics_(topics), token_(token), guesses_(guesses), client_(std::move(client)) {}

  struct Reaction {
    std::string reply;  ///< for the page; empty: none
    std::optional<CommandRequest> publish{};
    bool ends = false;  ///< the connection, after the reply
    /// The reply waits this long. The connection keeps its place until then, even when the client
    /// has gone: else one that guesses would come again at once.
    std::chrono::seconds delay{};
    bool drops_delayed_reply = false;  ///< a right token came after the wrong one
    std::string report{};              ///< for the log
  };
  Reaction on_text(std::string_view text, TimePoint now);

 private:
  Reaction on_token(const TokenOffer& offer, TimePoint now);
  Reaction on_wrong_token(TimePoint now);
  Reaction on_command(CommandRequest command, TimePoint now);
  bool take_turn(TimePoint now);

  const Topics& topics_;
  const std::string& token_;
  ClientCounts& guesses_;
  const Client client_;
  TimePoint answer_due_{};  ///< of a delayed answer
  bool may_send_ = false;
  unsigned wrong_tokens_ = 0;
  double turns_ = command_burst;
  std::optional<TimePoint> turns_at_{};
};

/// {"topic": "$web/refused", "payload": {"topic", "why"}}
std::string refusal(std::string_view topic, std::string_view why);

}  // namespace slamgw::web
