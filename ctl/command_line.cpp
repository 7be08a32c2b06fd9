// SPDX-License-Identifier: Apache-2.0
#include "ctl/command_line.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <iostream>
#include <optional>
#include <sstream>
#include <vector>

#include <unistd.h>

#include "ctl/terminal.hpp"
#include "daemon/core/edit_distance.hpp"

namespace slamgw::ctl {
namespace {

constexpr int exit_arguments = 2;

/// Refuses empty words: a variable of a script may be unset, and `watch --robot ""` must not mean
/// all robots.
void refuse_empty_words(CLI::App& app) {
  const auto complaint = [](const std::string& word) {
    return word.empty() ? "is empty; a text is needed" : "";
  };
  for (CLI::Option* const option : app.get_options())
    if (option->get_name() != "PAYLOAD") option->check(complaint);
  for (CLI::App* const verb : app.get_subcommands({})) refuse_empty_words(*verb);
}

std::string verbs_of(const CLI::App& app) {
  std::string names;
  for (const CLI::App* known : app.get_subcommands({}))
    names += (names.empty() ? "" : ", ") + known->get_name();
  return names;
}

/// Suggests the nearest verb; names all verbs if more than half of the word would have to change.
std::string suggestion(const CLI::App& app, const std::string& word) {
  constexpr std::size_t longest_compared = 64;
  std::string nearest;
  std::size_t least = std::string::npos;
  for (const CLI::App* known : app.get_subcommands({})) {
    const std::size_t distance = edit_distance(word.substr(0, longest_compared), known->get_name());
    if (distance < least) nearest = known->get_name();
    least = std::min(least, distance);
  }
  return 2 * least <= word.size() ? "did you mean " + nearest + "?" : "there are: " + verbs_of(app);
}

/// Names a missing or misspelt verb, or an unknown option before it; CLI11 only says that a verb is
/// required. The first word that is neither an option nor an option's value is the verb; after a
/// group such as `ble` or `store`, the second such word is a verb too.
std::optional<std::string> complaint_about_verb(const CLI::App& app,
                                                const std::vector<std::string>& words) {
  const CLI::App* group = &app;
  std::string before;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (words[i].starts_with("-")) {
      if (words[i] == "--help" || words[i] == "-h" || words[i] == "--version") return std::nullopt;
      if (!app.get_option_no_throw(words[i].substr(0, words[i].find('='))))
        return fmt::format("there is no option '{}' before a command (slam-gatewayctl {}--help)",
                           text_at({{"word", words[i]}}, "word"), before);
      if (words[i] == "--socket") ++i;
      continue;
    }
    const auto known = group->get_subcommands(
        [&word = words[i]](const CLI::App* verb) { return verb->get_name() == word; });
    if (known.empty())
      return fmt::format("there is no command '{}{}'; {} (slam-gatewayctl {}--help)", before,
                         text_at({{"word", words[i]}}, "word"), suggestion(*group, words[i]),
                         before);
    if (known.front()->get_require_subcommand_min() == 0) return std::nullopt;
    group = known.front();
    before += words[i] + " ";
  }
  return "a command is missing; there are: " + verbs_of(*group) + " (slam-gatewayctl " + before +
         "--help)";
}

/// Returns an example for verbs whose arguments are easily mistaken.
const char* hint(const CLI::App& app) {
  if (app.got_subcommand("watch"))
    return "for example: slam-gatewayctl watch --robot NRF_5 --type update\n";
  if (app.got_subcommand("send")) return "for example: slam-gatewayctl send NRF_5 cmd 40,-20\n";
  return "";
}

}  // namespace

std::variant<Order, Exit> parse_command_line(int argc, const char* const* argv) {
  Order order;
  CLI::App app("Asks and directs the running slam-gatewayd", "slam-gatewayctl");
  app.add_option("--socket", order.socket, "The daemon's control socket")->capture_default_str();
  app.add_flag("--json", order.json, "One JSON document; one a line where there are several");
  app.set_version_flag("--version", "slam-gatewayctl " SLAMGW_VERSION);
  app.fallthrough();
  app.require_subcommand(1);
  add_daemon_commands(app, order);
  add_host_commands(app, order);
  refuse_empty_words(app);
  try {
    std::vector<std::string> words(argv + 1, argv + argc);
    if (const auto complaint = complaint_about_verb(app, words)) {
      std::cerr << fit_to_terminal("slam-gatewayctl: " + *complaint + '\n', STDERR_FILENO);
      return Exit{exit_arguments};
    }
    std::reverse(words.begin(), words.end());  // CLI11 expects them in this order
    app.parse(words);
  } catch (const CLI::ParseError& error) {
    std::ostringstream out, complaint;
    const int status = app.exit(error, out, complaint) == 0 ? 0 : exit_arguments;
    std::cout << fit_to_terminal(out.str(), STDOUT_FILENO);
    std::cerr << fit_to_terminal(complaint.str(), STDERR_FILENO);
    if (status != 0) std::cerr << hint(app);
    return Exit{status};
  }
  return order;
}

}  // namespace slamgw::ctl
