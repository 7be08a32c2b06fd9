// SPDX-License-Identifier: Apache-2.0
// The rights to use the page, read from the file that `web.token_file` names. Each line is
// `NAME ROLE TOKEN`, ROLE `viewer` or `operator`; empty lines and lines that begin with `#` are
// ignored. One token alone is an operator's. Pure.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "web/server/client_counts.hpp"

namespace slamgw::web {

enum class Role { viewer, operator_ };  ///< an operator also sends commands
std::string_view to_string(Role role);

struct TokenHolder {
  std::string name;
  Role role = Role::viewer;
};

class Tokens {
 public:
  static constexpr std::size_t max_holders = 64;
  static constexpr std::size_t max_name = 32;

  /// Without tokens: every page may watch, and none may send commands.
  Tokens() = default;

  struct Problem {
    unsigned line = 1;
    std::string text;  ///< holds no part of a token
  };
  static std::variant<Tokens, Problem> parse(std::string_view text);

  bool empty() const { return holders_.empty(); }
  /// Returns whether watching needs a token, which is so once the file names a viewer.
  bool guard_watching() const { return guards_watching_; }
  /// A text that operators read; empty: none.
  const std::string& note() const { return note_; }
  void set_note(std::string note) { note_ = std::move(note); }
  /// Returns null for an unknown token. The time does not depend on where the first difference is.
  const TokenHolder* find(std::string_view token) const;

 private:
  struct Entry {
    TokenHolder holder;
    std::string token;
  };
  std::vector<Entry> holders_;
  std::string note_;
  bool guards_watching_ = false;
};

/// The token of an `Authorization: Bearer TOKEN` header (RFC 6750); empty when there is none.
std::string_view bearer_token(std::string_view authorization);

/// Delays the answers to a client's wrong tokens after the first few, on all of its connections
/// together. A person who mistypes a token does not notice.
class TokenGuesses {
 public:
  using TimePoint = ClientCounts::TimePoint;

  static constexpr unsigned prompt_answers = 5;
  static constexpr std::chrono::seconds first_delay{1};  ///< doubles with each wrong token
  /// An address may have eight pages, each of which can try two tokens in this time.
  static constexpr std::chrono::seconds longest_delay{30};

  struct Cost {
    std::chrono::seconds delay{};  ///< before the answer
    std::string report;            ///< for the log; empty: none
  };
  Cost on_wrong(const Client& client, TimePoint now);
  void forget(const Client& client) { counts_.forget(client); }
  std::uint64_t total() const { return counts_.total(); }
  std::size_t clients() const { return counts_.clients(); }

 private:
  ClientCounts counts_;
};

}  // namespace slamgw::web
