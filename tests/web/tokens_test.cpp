// SPDX-License-Identifier: Apache-2.0
#include "web/server/tokens.hpp"

#include <gtest/gtest.h>

namespace slamgw::web::test {
namespace {

Tokens good(std::string_view text) {
  auto parsed = Tokens::parse(text);
  const auto* problem = std::get_if<Tokens::Problem>(&parsed);
  EXPECT_EQ(problem, nullptr) << problem->text;
  return problem ? Tokens() : std::get<Tokens>(std::move(parsed));
}
Tokens::Problem bad(std::string_view text) {
  auto parsed = Tokens::parse(text);
  auto* problem = std::get_if<Tokens::Problem>(&parsed);
  EXPECT_NE(problem, nullptr) << text;
  return problem ? *problem : Tokens::Problem{};
}

constexpr const char* two =
    "# who may do what\n\nada operator 0123456789abcdef\r\n  bob\tviewer  fedcba9876543210";

TEST(WebTokens, NameHoldersAndRoles) {
  const Tokens tokens = good(two);
  ASSERT_TRUE(tokens.find("0123456789abcdef"));
  EXPECT_EQ(tokens.find("0123456789abcdef")->name, "ada");
  EXPECT_EQ(tokens.find("0123456789abcdef")->role, Role::operator_);
  ASSERT_TRUE(tokens.find("fedcba9876543210"));
  EXPECT_EQ(tokens.find("fedcba9876543210")->role, Role::viewer);
  EXPECT_TRUE(tokens.guard_watching());
}

TEST(WebTokens, SingleTokenBelongsToOperator) {
  const Tokens tokens = good("0123456789abcdef\n");
  ASSERT_TRUE(tokens.find("0123456789abcdef"));
  EXPECT_EQ(tokens.find("0123456789abcdef")->role, Role::operator_);
  EXPECT_FALSE(tokens.guard_watching());
  EXPECT_FALSE(good("ada operator 0123456789abcdef\n").guard_watching()) << "no viewer is named";
}

TEST(WebTokens, MatchOnlyAsWhole) {
  const Tokens tokens = good(two);
  for (const char* offered :
       {"", "0123456789abcde", "0123456789abcdeF", "0123456789abcdef0",
        "0123456789abcdef0123456789abcdef", "0123456789abcdef ", "ada", "operator"})
    EXPECT_FALSE(tokens.find(offered)) << offered;
  EXPECT_FALSE(Tokens().find("")) << "no token is set";
}

TEST(WebTokens, InvalidLineIsNamedByNumberAndNotShown) {
  const std::string first = "ada operator 0123456789abcdef\n";
  for (const std::string line :
       {"bob viewer", "bob viewer secret-6543210-x more", "bob owner secret-6543210-x",
        "bob viewer short-secret", "ada viewer secret-6543210-x", "bob viewer 0123456789abcdef",
        "b\x01 viewer secret-6543210-x", "secret-6543210-alone"}) {
    const Tokens::Problem problem = bad(first + line);
    EXPECT_EQ(problem.line, 2u) << line;
    EXPECT_EQ(problem.text.find("secret"), std::string::npos) << problem.text;
  }
  EXPECT_EQ(bad("secret-6543210-alone\n\nbob viewer fedcba9876543210").line, 3u);
  for (const char* nothing : {"", "\n", "# 0123456789abcdef\n"}) bad(nothing);
}

TEST(WebTokens, AreBounded) {
  std::string lines;
  for (std::size_t i = 0; i < Tokens::max_holders; ++i)
    lines += "n" + std::to_string(i) + " viewer 0123456789abcdef" + std::to_string(i) + "\n";
  good(lines);
  EXPECT_EQ(bad(lines + "one viewer more-than-there-are\n").line, Tokens::max_holders + 1);
  bad(std::string(Tokens::max_name + 1, 'n') + " viewer 0123456789abcdef");
  bad("n viewer " + std::string(257, 'x'));
}

TEST(WebTokens, AreReadFromBearerHeader) {
  for (const char* header : {"Bearer 0123456789abcdef", "bearer 0123456789abcdef"})
    EXPECT_EQ(bearer_token(header), "0123456789abcdef") << header;
  for (const char* header : {"", "Bearer", "Bearer ", "Basic 0123456789abcdef"})
    EXPECT_EQ(bearer_token(header), "") << header;
}

}  // namespace
}  // namespace slamgw::web::test
