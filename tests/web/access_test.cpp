// SPDX-License-Identifier: Apache-2.0
// Checks of Host and Origin, and the answers to HTTP requests.
#include "web/server/access.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "web/server/answers.hpp"

namespace slamgw::web::test {
namespace {

TEST(WebAccess, AcceptsAnyAddressAndConfiguredNamesAsHost) {
  const AccessRules access({"Slam.Example.org"});
  for (const char* host :
       {"127.0.0.1:8321", "127.0.0.1", "[::1]:8321", "192.168.1.7:80", "localhost:8321",
        "LOCALHOST", "slam.example.org", "SLAM.example.ORG:443"})
    EXPECT_TRUE(access.is_own_host(host)) << host;
  for (const char* host : {"", "evil.example", "evil.example:8321", "127.0.0.1.evil.example",
                           "localhost.evil.example", "127.0.0.1:8321@evil.example", "[::1]evil",
                           "[::1", "127.0.0.1:", "127.0.0.1:port", "slam.example.org.", ":8321"})
    EXPECT_FALSE(access.is_own_host(host)) << host;
}

TEST(WebAccess, AcceptsOriginOfThisHostOnly) {
  EXPECT_TRUE(AccessRules::is_own_origin("", "127.0.0.1:8321"));
  EXPECT_TRUE(AccessRules::is_own_origin("http://127.0.0.1:8321", "127.0.0.1:8321"));
  EXPECT_TRUE(AccessRules::is_own_origin("https://slam.example.org", "slam.example.org"));
  for (const char* origin :
       {"null", "http://evil.example", "http://127.0.0.1:9000", "http://127.0.0.1:83210",
        "http://127.0.0.1:8321.evil.example", "file://", "http://127.0.0.1"})
    EXPECT_FALSE(AccessRules::is_own_origin(origin, "127.0.0.1:8321")) << origin;
}

class WebAnswers : public testing::Test {
 protected:
  Answers answers{AccessRules({})};
  Request get(std::string_view target) const {
    Request request;
    request.method = "GET";
    request.target = target;
    request.host = "127.0.0.1:8321";
    return request;
  }
};

TEST_F(WebAnswers, ServePageAndMetrics) {
  EXPECT_EQ(answers.to(get("/")).content_type, "text/html; charset=utf-8");
  EXPECT_EQ(answers.to(get("/?x=1")).status, 200u);
  EXPECT_TRUE(answers.to(get("/metrics")).is_metrics);
  for (const char* path :
       {"/index.html/..", "/../server/main.cpp", "/etc/passwd", "//", "", "/%2e"})
    EXPECT_EQ(answers.to(get(path)).status, 404u) << path;
}

TEST_F(WebAnswers, RefuseForeignHostOriginAndMethods) {
  Request request = get("/");
  request.host = "evil.example:8321";
  EXPECT_EQ(answers.to(request).status, 403u);
  request.target = "/metrics";
  EXPECT_EQ(answers.to(request).status, 403u);
  EXPECT_FALSE(answers.to(request).is_metrics);
  request = get("/api");
  request.is_upgrade = true;
  EXPECT_TRUE(answers.to(request).is_web_socket);
  request.origin = "http://evil.example";
  EXPECT_EQ(answers.to(request).status, 403u);
  EXPECT_FALSE(answers.to(request).is_web_socket);
  request = get("/");
  request.method = "POST";
  EXPECT_EQ(answers.to(request).status, 405u);
  EXPECT_EQ(answers.to(get("/api")).status, 426u) << "only a WebSocket is served there";
}

TEST_F(WebAnswers, CompressOnRequestAndAnswerNotModified) {
  Request request = get("/");
  const Answer plain = answers.to(request);
  request.accept_encoding = "gzip, br";
  const Answer packed = answers.to(request);
  EXPECT_FALSE(plain.is_gzip);
  EXPECT_TRUE(packed.is_gzip);
  EXPECT_NE(plain.file, packed.file);
  request.if_none_match = packed.etag;
  EXPECT_EQ(answers.to(request).status, 304u);
  EXPECT_TRUE(answers.to(request).file.empty());
}

TEST(WebPage, IsSmallAndLoadsNothingFromElsewhere) {
  std::size_t octets = 0;
  for (const PageFile& file : page_files()) {
    octets += file.gzip.size();
    EXPECT_EQ(file.text.find("innerHTML"), file.text.npos) << file.path;
    EXPECT_EQ(file.text.find("//cdn"), file.text.npos) << file.path;
  }
  EXPECT_LE(octets, 60'000u);
}

}  // namespace
}  // namespace slamgw::web::test
