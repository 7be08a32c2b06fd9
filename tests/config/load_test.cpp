// SPDX-License-Identifier: Apache-2.0
// Configuration from this host's disk, with real modes and real certificates.
#include "daemon/config/io/load.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <sstream>

#include "daemon/config/io/service_rights.hpp"

namespace slamgw::test {
namespace {

std::string pem_of(const std::function<void(BIO*)>& write) {
  BIO* memory = BIO_new(BIO_s_mem());
  write(memory);
  char* text = nullptr;
  const long size = BIO_get_mem_data(memory, &text);
  std::string result(text, static_cast<std::size_t>(size));
  BIO_free(memory);
  return result;
}

struct Identity {
  std::string certificate;
  std::string key;
  std::string encrypted_key;
};

/// A new key and a certificate of its own.
Identity make_identity() {
  EVP_PKEY* key = EVP_EC_gen("P-256");
  X509* certificate = X509_new();
  X509_gmtime_adj(X509_getm_notBefore(certificate), 0);
  X509_gmtime_adj(X509_getm_notAfter(certificate), 3600);
  X509_set_pubkey(certificate, key);
  X509_sign(certificate, key, EVP_sha256());
  Identity identity;
  identity.certificate = pem_of([&](BIO* out) { PEM_write_bio_X509(out, certificate); });
  identity.key = pem_of(
      [&](BIO* out) { PEM_write_bio_PrivateKey(out, key, nullptr, nullptr, 0, nullptr, nullptr); });
  identity.encrypted_key = pem_of([&](BIO* out) {
    unsigned char phrase[] = "phrase";
    PEM_write_bio_PrivateKey(out, key, EVP_aes_128_cbc(), phrase, 6, nullptr, nullptr);
  });
  X509_free(certificate);
  EVP_PKEY_free(key);
  return identity;
}

class LoadConfig : public testing::Test {
 protected:
  LoadConfig() {
    std::string name = std::filesystem::temp_directory_path() / "slamgw-config-XXXXXX";
    directory_ = mkdtemp(name.data());
    unsetenv("CREDENTIALS_DIRECTORY");
  }
  ~LoadConfig() override {
    unsetenv("CREDENTIALS_DIRECTORY");
    std::filesystem::remove_all(directory_);
  }

  std::string write(const std::string& name, const std::string& text, mode_t mode = 0600) {
    const std::string path = directory_ / name;
    std::ofstream(path) << text;
    chmod(path.c_str(), mode);
    return path;
  }

  /// The problems of a configuration, without this test's directory, joined by line ends.
  /// Returns file, line and key of each line of `problems`.
  static std::string places_of(const std::string& problems) {
    std::string places;
    std::istringstream lines(problems);
    for (std::string line; std::getline(lines, line);)
      places += line.substr(0, line.find(": ", line.find(": ") + 2)) + "\n";
    return places;
  }
  std::string problems_of(const std::string& text) {
    std::string result;
    for (const Problem& problem : load_config(write("gateway.json", text)).problems)
      result += to_string(problem) + "\n";
    const std::string prefix = directory_.string() + "/";
    for (std::size_t at = result.find(prefix); at != result.npos; at = result.find(prefix))
      result.erase(at, prefix.size());
    return result;
  }

  std::filesystem::path directory_;
};

TEST_F(LoadConfig, NamesCommandThatCreatesMissingFile) {
  const std::string path = directory_ / "gone.json";
  const Problems problems = load_config(path).problems;
  ASSERT_EQ(problems.size(), 1U);
  EXPECT_EQ(to_string(problems[0]),
            path +
                ":1: file: cannot be read: No such file or directory; a readable file is "
                "needed, create it with: slam-gatewayd --print-config > " +
                path);
}

TEST_F(LoadConfig, RefusesDirectoryAndTooLargeFile) {
  EXPECT_NE(load_config(directory_).problems.at(0).text.find("not a regular file"),
            std::string::npos);
  const std::string large = write("large.json", std::string((1 << 20) + 1, ' '));
  EXPECT_NE(load_config(large).problems.at(0).text.find("larger than 1 MiB"), std::string::npos);
}

TEST_F(LoadConfig, RefusesCredentialsThatOthersCanRead) {
  const std::string text = R"({"broker": {"credentials_file": "c.json"}})";
  write("c.json", R"({"username": "u", "password": "p"})", 0604);
  EXPECT_EQ(
      problems_of(text),
      "gateway.json:1: broker.credentials_file: c.json can be read or changed by others (mode "
      "0604); type: sudo chmod o= c.json\n");
  write("c.json", R"({"username": "u", "password": "p"})", 0640);
  EXPECT_EQ(problems_of(text), "");
}

TEST_F(LoadConfig, RefusesCredentialsOwnedByAnotherUser) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can give files away";
  const std::string file = write("c.json", R"({"username": "u", "password": "p"})");
  ASSERT_EQ(chown(file.c_str(), 65534, 0), 0);
  EXPECT_EQ(problems_of(R"({"broker": {"credentials_file": "c.json"}})"),
            "gateway.json:1: broker.credentials_file: c.json belongs to nobody, who can read and "
            "change it; type: sudo chown root c.json\n");
  ASSERT_EQ(chown(file.c_str(), 0, 65534), 0);
  EXPECT_EQ(problems_of(R"({"broker": {"credentials_file": "c.json"}})"), "");
}

TEST_F(LoadConfig, RefusesAConfigurationThatOthersCanChange) {
  for (const mode_t mode : {0646, 0602, 0666}) {
    const Problems problems = load_config(write("g.json", "{}", mode)).problems;
    ASSERT_EQ(problems.size(), 1U) << mode;
    EXPECT_EQ(
        to_string(problems[0]),
        fmt::format("{}:1: file: can be changed by others (mode {:04o}); type: sudo chmod o-w "
                    "{}",
                    (directory_ / "g.json").string(), mode, (directory_ / "g.json").string()));
  }
  const std::string path = write("g.json", "{}", 0644);
  const std::string site = directory_ / "g.d";
  std::filesystem::create_directory(site);
  EXPECT_TRUE(load_config(path).problems.empty());
  write("g.d/a.json", "{}", 0646);
  EXPECT_EQ(load_config(path).problems.at(0).file, site + "/a.json");
  write("g.d/a.json", "{}", 0644);
  chmod(site.c_str(), 0777);
  EXPECT_EQ(load_config(path).problems.at(0).file, site) << "others can add a file to it";
}

TEST_F(LoadConfig, WarnsOfConfigurationOwnedByAnotherUser) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can give files away";
  const std::string path = write("g.json", "{}", 0644);
  const std::string site = directory_ / "g.d";
  std::filesystem::create_directory(site);
  const std::string part = write("g.d/a.json", "{}", 0644);
  for (const std::string& each : {path, site, part}) {
    ASSERT_EQ(chown(each.c_str(), 54321, 0), 0);
    const ParseResult loaded = load_config(path);
    EXPECT_TRUE(loaded.problems.empty());
    ASSERT_EQ(loaded.warnings.size(), 1U) << each;
    EXPECT_EQ(to_string(loaded.warnings[0]),
              each +
                  ":1: file: belongs to 54321, who can read and change it; type: sudo chown "
                  "root " +
                  each);
    ASSERT_EQ(chown(each.c_str(), 0, 65534), 0);
    EXPECT_TRUE(load_config(path).warnings.empty());
  }
}

TEST_F(LoadConfig, WarnsOfSecretThatOthersCanRead) {
  const std::string text =
      "{\n\"ble_mesh\": {\"provisioning\":\n{\"static_oob\": "
      "\"00112233445566778899aabbccddeeff\"}}}";
  const std::string path = write("g.json", text, 0644);
  const ParseResult result = load_config(path);
  EXPECT_TRUE(result.problems.empty());
  ASSERT_EQ(result.warnings.size(), 1U);
  EXPECT_EQ(to_string(result.warnings[0]),
            path +
                ":3: ble_mesh.provisioning.static_oob: is a secret in a file that others can "
                "read (mode 0644); type: sudo chown root:slam-gateway " +
                path + " && sudo chmod 640 " + path);
  EXPECT_TRUE(load_config(write("g.json", text, 0640)).warnings.empty());
  EXPECT_TRUE(load_config(write("g.json", "{}", 0644)).warnings.empty());
}

TEST_F(LoadConfig, ReadsCredentialFromSystemd) {
  write("broker", R"({"username": "from systemd", "password": "p"})", 0444);
  setenv("CREDENTIALS_DIRECTORY", directory_.c_str(), 1);
  const ParseResult result = load_config(write("gateway.json", "{}"));
  ASSERT_TRUE(result.config.broker.credentials);
  EXPECT_EQ(result.config.broker.credentials->username, "from systemd");
}

TEST_F(LoadConfig, FindsFilesThatServiceUserCannotRead) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can check the access of another user";
  std::filesystem::permissions(directory_, std::filesystem::perms(0755));
  const std::string user = "bin";  // Debian's base system has it; it has no rights here
  EXPECT_FALSE(may_user_read(user, write("closed.json", "{}", 0600)));
  EXPECT_TRUE(may_user_read(user, write("open.json", "{}", 0644)));
  EXPECT_TRUE(may_user_read(user, directory_ / "missing.json"))
      << "a missing file is not a matter of rights";
  EXPECT_TRUE(may_user_read("no-such-user", directory_ / "closed.json"));
  std::filesystem::permissions(directory_, std::filesystem::perms(0700));
  EXPECT_FALSE(may_user_read(user, directory_ / "open.json")) << "it may not enter the directory";
}

TEST_F(LoadConfig, RefusesDropInDirectoryThatItCannotRead) {
  const std::string path = write("g.json", "{}", 0644);
  write("g.d", "no directory");
  const ParseResult file = load_config(path);
  ASSERT_EQ(file.problems.size(), 1U);
  EXPECT_EQ(to_string(file.problems[0]),
            (directory_ / "g.d").string() +
                ":1: file: cannot be read: Not a directory; a readable directory, or none, is "
                "needed");
  if (geteuid() != 0) GTEST_SKIP() << "only root can become another user";
  std::filesystem::remove(directory_ / "g.d");
  std::filesystem::create_directory(directory_ / "g.d");
  write("g.d/a.json", R"({"bans": ["robot-1"]})", 0644);
  std::filesystem::permissions(directory_ / "g.d", std::filesystem::perms(0700));
  std::filesystem::permissions(directory_, std::filesystem::perms(0755));
  constexpr uid_t other_user = 65534;
  ASSERT_EQ(seteuid(other_user), 0);
  const ParseResult closed = load_config(path);
  const ParseResult shared = load_shared_config(path);
  ASSERT_EQ(seteuid(0), 0);
  ASSERT_EQ(closed.problems.size(), 1U) << "else the banned robot could connect";
  const std::string words =
      fmt::format("{0}:1: file: cannot be read: Permission denied; type: sudo chmod 755 {0}",
                  (directory_ / "g.d").string());
  EXPECT_EQ(to_string(closed.problems[0]), words);
  EXPECT_TRUE(shared.problems.empty());
  ASSERT_EQ(shared.warnings.size(), 1U);
  EXPECT_EQ(to_string(shared.warnings[0]), words);
}

TEST_F(LoadConfig, DropInFilesOverrideKeyByKeyInOrderOfName) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("gateway.d/10-broker.json", R"({"broker": {"uri": "mqtt://first", "keep_alive_s": 60}})");
  write("gateway.d/20-broker.json",
        "// later\n"
        R"({"broker": {"uri": "mqtt://second"}, "robots": [{"id": "r", "ble_address": 3}]})");
  write("gateway.d/30-old.json.dpkg-old", "this is no JSON");
  write("gateway.d/.40-hidden.json", "this is no JSON");
  std::filesystem::create_symlink("root@pi.812:1", directory_ / "gateway.d/.#10-broker.json");
  const ParseResult result = load_config(write("gateway.json", R"({"broker": {"uri": "mqtt://h"},
      "robots": [{"id": "a", "ble_address": 1}, {"id": "b", "ble_address": 2}]})"));
  EXPECT_TRUE(result.problems.empty());
  EXPECT_EQ(result.config.broker.host, "second");
  EXPECT_EQ(result.config.broker.keep_alive, std::chrono::seconds{60});
  ASSERT_EQ(result.config.robots.size(), 1U);
  EXPECT_EQ(result.config.robots[0].id, "r");
}

TEST_F(LoadConfig, WarnsOfDropInFilesThatItDoesNotRead) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("gateway.d/site.json", "{}");
  write("gateway.d/broker.jsn", R"({"broker": {"uri": "mqtt://other"}})");
  write("gateway.d/robots", "{}");
  for (const char* const ignored :
       {"site.json~", ".site.json.swp", "site.json.dpkg-old", ".site.json"})
    write(std::string("gateway.d/") + ignored, "{}");
  const ParseResult result = load_config(write("gateway.json", "{}"));
  EXPECT_TRUE(result.problems.empty());
  std::string warnings;
  for (const Problem& warning : result.warnings)
    warnings +=
        std::filesystem::path(warning.file).filename().string() + ": " + warning.text + "\n";
  EXPECT_EQ(warnings,
            "broker.jsn: is not read because its name does not end in .json; rename or remove it\n"
            "robots: is not read because its name does not end in .json; rename or remove it\n");
}

TEST_F(LoadConfig, NamesTheFileAndLineOfEachProblem) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("gateway.d/a.json", "{\n\"log\": {\"level\": \"loud\"}}");
  write("gateway.d/b.json", "{\n\n\"broker\": {\"url\": 1}}");
  write("gateway.d/c.json", R"({"robots": [{"id": "a"}]})");
  const std::string problems = problems_of(R"({"log": {"level": "info", "traffic": "some"}})");
  EXPECT_TRUE(problems.starts_with("gateway.json:1: log.traffic: ")) << problems;
  EXPECT_NE(problems.find("\ngateway.d/a.json:2: log.level: "), problems.npos) << problems;
  EXPECT_NE(problems.find("\ngateway.d/b.json:3: broker.url: "), problems.npos) << problems;
  EXPECT_NE(problems.find("\ngateway.d/c.json:1: robots[0]: "), problems.npos) << problems;
  write("gateway.d/b.json", "{");
  EXPECT_NE(problems_of("{}").find("gateway.d/b.json:1: syntax: "), std::string::npos);
}

TEST_F(LoadConfig, ReportsWrongKeysOfOtherFilesBesideSyntaxError) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("gateway.d/a.json", R"({"broker": {"url": 1}})");
  write("gateway.d/b.json", R"({"broker": {"tls": {"key_file": "k.pem"}})");
  write("gateway.d/c.json", R"(["mqttsn"])");
  write("gateway.d/d.json", R"({"log": {"level": "loud"}})");
  const std::string tls = R"({"broker": {"tls": {"certificate_file": "c.pem"}}})";
  const std::string problems = problems_of(tls);
  EXPECT_EQ(places_of(problems),
            "gateway.d/a.json:1: broker.url\n"
            "gateway.d/b.json:1: syntax\n"
            "gateway.d/c.json:1: syntax\n"
            "gateway.d/d.json:1: log.level\n")
      << problems << "b.json may hold the key_file that gateway.json lacks";
}

TEST_F(LoadConfig, ReportsWrongValuesThatLaterFilesOverrule) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("gateway.d/a.json", R"({"zz": 2, "mqttsn": 5, "fleet": {"enabled": true}})");
  write("gateway.d/b.json", R"({"log": {"level": "soft"}, "zz": 3, "mqttsn": {"gateway_id": 2}})");
  write("gateway.d/c.json", R"({"log": {"level": "info"}, "fleet": {"enabled": false}})");
  const std::string problems = problems_of(R"({"log": {"level": "loud"}, "zz": 1})");
  EXPECT_EQ(places_of(problems),
            "gateway.json:1: log.level\n"
            "gateway.json:1: zz\n"
            "gateway.d/a.json:1: zz\n"
            "gateway.d/a.json:1: mqttsn\n"
            "gateway.d/b.json:1: log.level\n"
            "gateway.d/b.json:1: zz\n")
      << problems;
  EXPECT_EQ(load_config(directory_ / "gateway.json").notices.size(), 2U) << "one for each file";
}

TEST_F(LoadConfig, WarnsOfBansThatLaterFileOverrules) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  const std::string path = write("gateway.json", "{\n\"bans\": [\"tank\", \"mole\", \"fd00::1\"]}");
  const std::string later = write("gateway.d/bans.json", R"({"bans": ["mole"]})");
  const ParseResult result = load_config(path);
  EXPECT_TRUE(result.problems.empty());
  ASSERT_EQ(result.warnings.size(), 1U);
  EXPECT_EQ(to_string(result.warnings[0]),
            path + ":2: bans: does not ban tank and 1 more, because " + later +
                " replaces this list; write all bans there, or remove these here");
  write("gateway.d/bans.json", R"({"bans": ["fd00::0:1", "mole", "tank", "rat"]})");
  EXPECT_TRUE(load_config(path).warnings.empty()) << "all of them are banned";
  write("gateway.d/bans.json", R"({"bans": []})");
  write("gateway.d/more.json", R"({"bans": ["tank"]})");
  const Problems warnings = load_config(path).warnings;
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings[0].text.find("does not ban mole and 1 more, because " +
                                  (directory_ / "gateway.d/more.json").string()),
            std::string::npos);
}

TEST_F(LoadConfig, ResolvesRelativePathsAgainstMainFile) {
  std::filesystem::create_directory(directory_ / "gateway.d");
  write("c.json", R"({"username": "u", "password": "p"})");
  write("gateway.d/a.json", R"({"broker": {"credentials_file": "c.json"}})");
  EXPECT_EQ(problems_of("{}"), "");
}

TEST_F(LoadConfig, ChecksCertificatesAndKeys) {
  const Identity own = make_identity();
  const Identity other = make_identity();
  const std::string text = R"({"broker": {"uri": "mqtts://h", "tls": {"ca_file": "ca",
      "certificate_file": "cert", "key_file": "key"}}})";
  write("ca", own.certificate + other.certificate);
  write("cert", own.certificate);
  write("key", own.key);
  EXPECT_EQ(problems_of(text), "");
  write("key", other.key);
  EXPECT_NE(problems_of(text).find("key_file: does not belong"), std::string::npos);
  write("key", own.encrypted_key);
  EXPECT_NE(problems_of(text).find("key holds a private key with a pass phrase"),
            std::string::npos);
  write("key", own.certificate);
  EXPECT_NE(problems_of(text).find("key holds no private key"), std::string::npos);
  write("ca", "");
  EXPECT_NE(problems_of(text).find("ca holds no certificate"), std::string::npos);
  write("ca", own.certificate + other.certificate.substr(0, 200));
  EXPECT_NE(problems_of(text).find("ca holds a broken certificate"), std::string::npos);
}

}  // namespace
}  // namespace slamgw::test
