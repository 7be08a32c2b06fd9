// SPDX-License-Identifier: Apache-2.0
// What slam-gateway-web reads at its start, with real files and modes: its own secrets, and none of
// the daemon's.
#include "web/server/io/startup.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <unistd.h>

#include <cstdlib>
#include <filesystem>

#include "tests/support/certificates.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::web::test {
namespace {

constexpr const char* token = "0123456789abcdef";

class WebStartup : public testing::Test {
 protected:
  void write(const std::string& name, const std::string& text, unsigned mode = 0600) {
    slamgw::test::write_file(path(name), text, mode);
  }
  std::string path(const std::string& name) const { return directory_ / name; }
  Startup load() const { return load_startup(path("gateway.json")); }
  std::string problem() const {
    const Startup startup = load();
    return startup.parsed.problems.empty() ? "" : to_string(startup.parsed.problems.front());
  }

  void SetUp() override { unsetenv("CREDENTIALS_DIRECTORY"); }

 private:
  slamgw::test::TempDir directory_;
};

TEST_F(WebStartup, OnlyWatchesWhenNoTokenIsSet) {
  write("gateway.json", "{}");
  EXPECT_EQ(problem(), "");
  EXPECT_TRUE(load().tokens.empty());
  EXPECT_EQ(load().parsed.config.web.listen, "127.0.0.1:8321");
}

TEST_F(WebStartup, UsesLibmosquittoForAnyClientOfGateway) {
  write("gateway.json", R"({"broker": {"client": "paho"}})");
  EXPECT_EQ(problem(), "");
  EXPECT_EQ(load().parsed.config.broker.client, MqttClient::mosquitto);
}

TEST_F(WebStartup, ReadsTokenFile) {
  write("gateway.json", R"({"web": {"token_file": "token"}})");
  write("token", std::string(token) + "\n");
  EXPECT_EQ(problem(), "");
  EXPECT_TRUE(load().tokens.find(token));
}

TEST_F(WebStartup, RefusesATokenThatOthersCanRead) {
  write("gateway.json", R"({"web": {"token_file": "token"}})");
  for (const unsigned mode : {0644u, 0604u, 0602u}) {
    write("token", token, mode);
    EXPECT_NE(problem().find("web.token_file"), std::string::npos) << mode;
    EXPECT_NE(problem().find("chmod o="), std::string::npos) << mode;
    EXPECT_TRUE(load().tokens.empty()) << mode;
  }
  write("token", token, 0640);
  EXPECT_EQ(problem(), "");
}

TEST_F(WebStartup, ReadsNoteThatOthersCannotRead) {
  write("gateway.json", R"({"web": {"note_file": "note"}})");
  EXPECT_NE(problem().find("a text is needed"), std::string::npos) << problem();
  write("note", "password: x", 0644);
  EXPECT_NE(problem().find("web.note_file"), std::string::npos) << problem();
  write("note", std::string(4097, 'x'), 0640);
  EXPECT_NE(problem().find("more than 4096 octets"), std::string::npos) << problem();
  for (const char* const unprintable : {"\xff", "\x1b[2J", "\xe2\x80\xae"}) {
    write("note", unprintable, 0640);
    EXPECT_NE(problem().find("is not plain text"), std::string::npos) << problem();
  }
  write("note", "user: é\npassword: x\n", 0640);
  EXPECT_EQ(problem(), "");
  EXPECT_EQ(load().tokens.note(), "user: é\npassword: x\n");
}

TEST_F(WebStartup, RefusesTokenOwnedByAnotherUser) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can give files away";
  write("gateway.json", R"({"web": {"token_file": "token"}})");
  write("token", token);
  ASSERT_EQ(chown(path("token").c_str(), 65534, 0), 0);
  EXPECT_NE(problem().find("belongs to nobody, who can read and change it; type: sudo chown root"),
            std::string::npos)
      << problem();
  EXPECT_TRUE(load().tokens.empty());
}

TEST_F(WebStartup, ListensForOtherHostsWithTokenOnly) {
  for (const std::string listen : {"0.0.0.0:8321", "[::]:8321", "192.168.1.20:8321"}) {
    write("gateway.json", R"({"web": {"listen": ")" + listen + "\"}}");
    EXPECT_EQ(problem(), path("gateway.json") + ":1: web.listen: " + listen +
                             " can be reached from other hosts, and no token protects the robots; "
                             "set web.token_file, or use 127.0.0.1");
    write("token", token);
    write("gateway.json", R"({"web": {"token_file": "token", "listen": ")" + listen + "\"}}");
    EXPECT_EQ(problem(), "");
  }
  for (const std::string listen : {"127.0.0.1:1", "127.3.0.1:1", "[::1]:1"}) {
    write("gateway.json", R"({"web": {"listen": ")" + listen + "\"}}");
    EXPECT_EQ(problem(), "");
  }
}

TEST_F(WebStartup, RefusesInvalidTokenAndNeverShowsIt) {
  write("gateway.json", R"({"web": {"token_file": "token"}})");
  EXPECT_NE(problem().find("cannot be read"), std::string::npos) << "it is missing";
  for (const std::string text : {"", "\n", "short-secret", "two words of a secret",
                                 "line-of-a-secret-1\nline-of-a-secret-2"}) {
    write("token", text);
    EXPECT_NE(problem().find("each line is NAME ROLE TOKEN"), std::string::npos) << text;
    EXPECT_EQ(problem().find("secret-"), std::string::npos) << text;
  }
  write("token", std::string(257, 'x'));
  EXPECT_NE(problem().find("token:1: the token is not 16 to 256"), std::string::npos) << problem();
}

TEST_F(WebStartup, UsesOwnCredentialsAndNotThoseOfDaemon) {
  write("gateway.json",
        R"({"broker": {"credentials_file": "of-the-daemon.json", "uri": "mqtts://broker",
            "tls": {"certificate_file": "of-the-daemon.pem", "key_file": "of-the-daemon.key"}}})");
  EXPECT_EQ(problem(), "") << "the daemon's files are not read";
  EXPECT_FALSE(load().parsed.config.broker.credentials);
  EXPECT_FALSE(load().parsed.config.broker.key_file) << "it cannot be read";
  write("web-credentials.json", R"({"username": "page", "password": "p"})");
  ASSERT_TRUE(load().parsed.config.broker.credentials);
  EXPECT_EQ(load().parsed.config.broker.credentials->username, "page");
  write("web-credentials.json", R"({"username": "page", "password": "p"})", 0644);
  EXPECT_NE(problem().find("can be read or changed by others"), std::string::npos);
}

TEST_F(WebStartup, RefusesUnusableTlsFiles) {
  const slamgw::test::Certificates good("broker");
  const slamgw::test::Certificates other("broker");
  const auto use = [&](const std::string& ca, const std::string& key) {
    write("gateway.json", R"({"broker": {"uri": "mqtts://broker", "tls": {"ca_file": ")" + ca +
                              R"(", "certificate_file": ")" + good.certificate() +
                              R"(", "key_file": ")" + key + "\"}}}");
  };
  use(good.ca(), good.key());
  EXPECT_EQ(problem(), "");
  EXPECT_TRUE(load().parsed.config.broker.key_file);
  use(path("none.pem"), good.key());
  EXPECT_NE(problem().find("none.pem cannot be read"), std::string::npos) << problem();
  use(good.key(), good.key());
  EXPECT_NE(problem().find("a certificate as PEM is needed"), std::string::npos) << problem();
  use(good.ca(), other.key());
  EXPECT_NE(problem().find("does not belong to certificate_file"), std::string::npos) << problem();
}

TEST_F(WebStartup, RefusesReadableSourceOfSystemdCredential) {
  write("gateway.json", "{}");
  std::filesystem::create_directory(path("copies"));
  write("copies/broker", R"({"username": "page", "password": "p"})");
  setenv("CREDENTIALS_DIRECTORY", path("copies").c_str(), 1);
  EXPECT_EQ(problem(), "") << "the service may lack access to the source";
  write("web-credentials.json", R"({"username": "page", "password": "p"})", 0644);
  EXPECT_NE(problem().find("web-credentials.json:1: file: can be read or changed by others"),
            std::string::npos);
  write("web-credentials.json", R"({"username": "page", "password": "p"})", 0600);
  EXPECT_EQ(problem(), "");
  unsetenv("CREDENTIALS_DIRECTORY");
}

TEST_F(WebStartup, ReportsProblemsOfWholeConfiguration) {
  write("gateway.json", R"({"web": {"listn": "127.0.0.1:1"}})");
  EXPECT_NE(problem().find("did you mean"), std::string::npos) << problem();
  EXPECT_NE(load_startup(path("missing.json")).parsed.problems.size(), 0u);
}

}  // namespace
}  // namespace slamgw::web::test
