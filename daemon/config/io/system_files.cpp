// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/io/system_files.hpp"

#include <fcntl.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <memory>

#include "daemon/core/freed_by.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw {
namespace {

constexpr std::size_t max_file_bytes = 1 << 20;

using Bio = std::unique_ptr<BIO, FreedBy<BIO_free>>;
using Certificate = std::unique_ptr<X509, FreedBy<X509_free>>;
using Key = std::unique_ptr<EVP_PKEY, FreedBy<EVP_PKEY_free>>;

FileError error_now() { return {errno == ENOENT, errno == EACCES, std::strerror(errno)}; }

Bio open_text(const std::string& pem) {
  return Bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
}

Certificate read_certificate(BIO* pem) {
  return Certificate(PEM_read_bio_X509(pem, nullptr, nullptr, nullptr));
}

/// Without this, OpenSSL would ask for a pass phrase on the terminal.
int no_pass_phrase(char*, int, int, void* was_asked) {
  *static_cast<bool*>(was_asked) = true;
  return -1;
}

Key read_key(const std::string& pem, bool& is_encrypted) {
  Key key(PEM_read_bio_PrivateKey(open_text(pem).get(), nullptr, no_pass_phrase, &is_encrypted));
  ERR_clear_error();
  return key;
}

}  // namespace

Result<FileText, FileError> SystemFiles::read(const std::string& path) const {
  // Non-blocking: a FIFO must not hold up the start.
  const OwnedFile file(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (file.get() < 0) return error_now();
  struct stat status {};
  if (fstat(file.get(), &status) != 0) return error_now();
  if (!S_ISREG(status.st_mode)) return FileError{false, false, "it is not a regular file"};
  FileText result{{}, status.st_mode & 0777u, strange_owner(status.st_uid)};
  std::array<char, 4096> chunk{};
  while (true) {
    const ssize_t count = ::read(file.get(), chunk.data(), chunk.size());
    if (count < 0) return error_now();
    if (count == 0) return result;
    result.text.append(chunk.data(), static_cast<std::size_t>(count));
    if (result.text.size() > max_file_bytes)
      return FileError{false, false, "it is larger than 1 MiB"};
  }
}

std::string SystemFiles::strange_owner(unsigned user) const {
  if (user == 0 || user == geteuid()) return {};
  const passwd* const service = getpwnam(service_user_);
  if (service != nullptr && service->pw_uid == user) return {};
  const passwd* const owner = getpwuid(user);
  return owner != nullptr ? owner->pw_name : std::to_string(user);
}

std::string SystemFiles::certificate_fault(const std::string& pem) const {
  const Bio text = open_text(pem);
  int count = 0;
  while (read_certificate(text.get())) ++count;
  // Reading may end only at the end of the text, which OpenSSL reports as a missing start line.
  const unsigned long reason = ERR_peek_last_error();
  ERR_clear_error();
  if (ERR_GET_LIB(reason) != ERR_LIB_PEM || ERR_GET_REASON(reason) != PEM_R_NO_START_LINE)
    return "holds a broken certificate";
  return count > 0 ? "" : "holds no certificate";
}

std::string SystemFiles::key_fault(const std::string& pem) const {
  bool is_encrypted = false;
  if (read_key(pem, is_encrypted)) return "";
  return is_encrypted ? "holds a private key with a pass phrase" : "holds no private key";
}

bool SystemFiles::key_matches(const std::string& certificate_pem,
                              const std::string& key_pem) const {
  const Certificate certificate = read_certificate(open_text(certificate_pem).get());
  bool is_encrypted = false;
  const Key key = read_key(key_pem, is_encrypted);
  const bool matches =
      certificate && key && X509_check_private_key(certificate.get(), key.get()) == 1;
  ERR_clear_error();
  return matches;
}

}  // namespace slamgw
