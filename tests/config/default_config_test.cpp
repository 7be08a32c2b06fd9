// SPDX-License-Identifier: Apache-2.0
// config/gateway.json: the program prints it, it states the defaults, and it has every key.
#include "daemon/config/default_config.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "daemon/config/parse.hpp"
#include "daemon/config/schema.hpp"
#include "tests/config/describe.hpp"
#include "tests/config/fake_files.hpp"

namespace slamgw::test {
namespace {

const Environment here{"gateway-1", ""};

std::string all_lines(const Problems& problems) {
  std::string result;
  for (const Problem& problem : problems) result += to_string(problem) + "\n";
  return result;
}

/// The default configuration with its example keys made effective.
std::string with_examples() {
  std::istringstream lines{std::string(default_config_text)};
  std::string result;
  for (std::string line; std::getline(lines, line);) {
    const std::size_t at = line.find_first_not_of(' ');
    const std::string_view text = at == line.npos ? "" : std::string_view(line).substr(at);
    if (text.starts_with("// \"") || text.starts_with("// {\"")) line.erase(at, 3);
    result += line + "\n";
  }
  return result;
}

std::string row_of(std::string path) {
  for (std::size_t at = path.find('['); at != path.npos; at = path.find('[', at + 1))
    path.erase(at + 1, path.find(']', at) - at - 1);
  return path;
}

TEST(DefaultConfig, IsTheShippedFile) {
  std::ifstream file(SLAMGW_SOURCE_DIR "/config/gateway.json");
  std::ostringstream text;
  text << file.rdbuf();
  ASSERT_FALSE(text.str().empty());
  EXPECT_EQ(text.str(), default_config_text);
}

TEST(DefaultConfig, StatesDefaultOfEveryKey) {
  const ParseResult shipped =
      parse_config({{"gateway.json", std::string(default_config_text)}}, here, FakeFiles());
  const ParseResult empty = parse_config({{"gateway.json", "{}"}}, here, FakeFiles());
  EXPECT_EQ(all_lines(shipped.problems), "");
  EXPECT_EQ(describe(shipped.config), describe(empty.config));
}

TEST(DefaultConfig, EmptyConfigurationEqualsDefaultsOfTheStructs) {
  Config expected;
  expected.gateway_id = "gateway-1";
  expected.broker.client_id = "slam-gateway-gateway-1";
  expected.broker.gateway_id = expected.gateway_id;
  const ParseResult empty = parse_config({{"gateway.json", "{}"}}, here, FakeFiles());
  EXPECT_EQ(describe(empty.config), describe(expected));
}

TEST(DefaultConfig, NamesEveryKeyAndHasValidExamples) {
  FakeFiles files;
  files.files["credentials.json"] = {R"({"username": "u", "password": "p"})", 0600};
  files.files["ca.pem"] = files.files["client.pem"] = {"certificate 1", 0644};
  files.files["robot-keys.json"] = {"{}", 0600};
  files.files["client.key"] = {"key 1", 0600};
  std::string text = with_examples();
  text.replace(text.find("\"mqtt://"), 8, "\"mqtts://");  // the examples for TLS need it
  const ParseResult result = parse_config({{"gateway.json", std::string(text)}}, here, files);
  EXPECT_EQ(all_lines(result.problems), "");
  std::map<std::string, int> rows;
  for (const auto& [path, place] : result.places) rows[row_of(path)] = place.line;
  for (const SchemaKey& key : schema())
    EXPECT_TRUE(rows.contains(std::string(key.path))) << key.path;
}

}  // namespace
}  // namespace slamgw::test
