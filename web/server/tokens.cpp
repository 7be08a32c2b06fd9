// SPDX-License-Identifier: Apache-2.0
#include "web/server/tokens.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/algorithm/string/predicate.hpp>
#include <iterator>
#include <locale>
#include <sstream>

namespace slamgw::web {
namespace {

bool is_printable(std::string_view text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c < '\x7f'; });
}

bool is_token(std::string_view text) {
  return text.size() >= 16 && text.size() <= 256 && is_printable(text);
}

std::vector<std::string> words_of(std::string_view line) {
  std::istringstream in{std::string(line)};
  return {std::istream_iterator<std::string>(in), {}};
}

bool is_same(std::string_view expected, std::string_view offered) {
  unsigned difference = expected.size() == offered.size() ? 0 : 1;
  for (std::size_t i = 0; i < offered.size(); ++i)
    difference |= static_cast<unsigned char>(offered[i]) ^
                  static_cast<unsigned char>(expected[i % expected.size()]);
  return difference == 0;
}

}  // namespace

std::string_view to_string(Role role) { return role == Role::viewer ? "viewer" : "operator"; }

std::variant<Tokens, Tokens::Problem> Tokens::parse(std::string_view text) {
  Tokens tokens;
  bool is_alone = false;  // a token without a name
  for (unsigned line = 1; !text.empty(); ++line) {
    const std::string_view row = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(row.size() + 1, text.size()));
    auto words = words_of(row);
    if (words.empty() || words[0].starts_with('#')) continue;
    if (words.size() == 1 && tokens.empty()) {
      is_alone = true;
      words = {"operator", "operator", words[0]};
    } else if (words.size() != 3 || is_alone) {
      return Problem{line, "the line is not `NAME ROLE TOKEN`"};
    }
    if (words[0].size() > max_name || !is_printable(words[0]))
      return Problem{line, fmt::format("the name is not 1 to {} printable characters", max_name)};
    if (words[1] != "viewer" && words[1] != "operator")
      return Problem{line, "the role is not `viewer` or `operator`"};
    if (!is_token(words[2]))
      return Problem{line, "the token is not 16 to 256 printable characters without spaces"};
    const bool is_taken =
        tokens.find(words[2]) || std::ranges::any_of(tokens.holders_, [&](const Entry& known) {
          return known.holder.name == words[0];
        });
    if (is_taken) return Problem{line, "an earlier line has this name or this token"};
    if (tokens.holders_.size() == max_holders)
      return Problem{line, fmt::format("there are more than {} tokens", max_holders)};
    const Role role = words[1] == "viewer" ? Role::viewer : Role::operator_;
    tokens.guards_watching_ = tokens.guards_watching_ || role == Role::viewer;
    tokens.holders_.push_back({{words[0], role}, words[2]});
  }
  if (tokens.empty()) return Problem{1, "the file has no token"};
  return tokens;
}

const TokenHolder* Tokens::find(std::string_view token) const {
  const TokenHolder* found = nullptr;
  for (const Entry& entry : holders_)
    if (is_same(entry.token, token)) found = &entry.holder;
  return found;
}

std::string_view bearer_token(std::string_view authorization) {
  constexpr std::string_view scheme = "Bearer ";  // in any case (RFC 9110 section 11.1)
  return boost::algorithm::istarts_with(authorization, scheme, std::locale::classic())
             ? authorization.substr(scheme.size())
             : std::string_view{};
}

TokenGuesses::Cost TokenGuesses::on_wrong(const Client& client, TimePoint now) {
  const unsigned guesses = counts_.add(client, now);
  Cost cost;
  if (guesses <= prompt_answers) return cost;
  if (guesses == prompt_answers + 1)
    cost.report = fmt::format("{} wrong tokens from {}: answers to more of them are delayed",
                              guesses, client.name);
  const unsigned doublings = std::min(guesses - prompt_answers - 1, 5U);  // 32 s is enough
  cost.delay = std::min(first_delay * (1U << doublings), longest_delay);
  return cost;
}

}  // namespace slamgw::web
