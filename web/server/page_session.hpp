// SPDX-License-Identifier: Apache-2.0
// Decides what one page may do by its token. Without a token, the page watches; where watching also
// needs a token, it waits for one. Pure: takes texts and `now`, returns a reaction.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "daemon/core/token_bucket.hpp"
#include "web/server/mirror.hpp"
#include "web/server/tokens.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

class PageSession {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  /// The connection ends after this many wrong tokens, so that guessing is slow.
  static constexpr unsigned max_wrong_tokens = 3;
  /// Fast enough for a person and a script; a faulty page must not flood a mesh.
  static constexpr unsigned commands_per_second = 20;
  static constexpr unsigned command_burst = 40;

  /// `guesses`: those of all clients. The references must outlive the session.
  PageSession(const Topics& topics, const Tokens& tokens, TokenGuesses& guesses, Client client)
      : topics_(topics), tokens_(tokens), guesses_(guesses), client_(std::move(client)) {}

  struct Reaction {
    std::string reply;  ///< for the page; empty: none
    std::optional<CommandRequest> publish{};
    std::vector<std::string> history{};           ///< robots whose history the page asks for
    std::optional<std::int64_t> past_since_ms{};  ///< the page asks for the past from here on
    bool ends = false;                            ///< the connection ends after the reply
    /// The reply waits this long. The connection keeps its place until then, even when the client
    /// has gone: otherwise a client that guesses tokens could reconnect at once.
    std::chrono::seconds delay{};
    bool drops_delayed_reply = false;  ///< a right token came after the wrong one
    std::string report{};              ///< for the log
  };
  Reaction on_text(std::string_view text, TimePoint now);
  bool may_watch() const { return holder_ || !tokens_.guard_watching(); }

 private:
  Reaction on_token(const TokenOffer& offer, TimePoint now);
  Reaction on_wrong_token(TimePoint now);
  Reaction on_command(CommandRequest command, TimePoint now);
  Reaction on_history(HistoryRequest request, TimePoint now);
  bool take_turn(TimePoint now) { return turns_.take(command_burst, commands_per_second, now); }

  const Topics& topics_;
  const Tokens& tokens_;
  TokenGuesses& guesses_;
  const Client client_;
  TimePoint answer_due_{};               ///< when the delayed answer is sent
  bool has_past_ = false;                ///< sent once for each connection: it has megabytes
  const TokenHolder* holder_ = nullptr;  ///< holder of the token that the page has sent
  unsigned wrong_tokens_ = 0;
  TokenBucket turns_;
};

/// {"topic": "$web/refused", "payload": {"topic", "why"}}
std::string refusal(std::string_view topic, std::string_view why);

}  // namespace slamgw::web
