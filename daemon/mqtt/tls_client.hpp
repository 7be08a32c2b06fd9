// SPDX-License-Identifier: Apache-2.0
// TLS towards one broker as OpenSSL needs it: files, the check of certificate and host name, the
// name in the ClientHello. Reads files: not on the loop.
#pragma once

#include <openssl/ssl.h>

#include <memory>
#include <string>

#include "daemon/mqtt/settings.hpp"

namespace slamgw {

class TlsClient {
 public:
  explicit TlsClient(const BrokerSettings& broker);
  TlsClient(const TlsClient&) = delete;
  TlsClient& operator=(const TlsClient&) = delete;

  /// Why a file can't be used; empty when all can.
  const std::string& problem() const { return problem_; }
  /// For SSL_new(); each session of it verifies the certificate and the broker's name, whatever
  /// address or name it is connected to. Outlived by this object.
  SSL_CTX* context() const { return context_.get(); }
  /// Why a handshake has refused the broker's certificate, for the operator; empty when none has.
  std::string certificate_problem() const;
  bool has_shaken_hands() const { return has_shaken_hands_; }

 private:
  struct Free {
    void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
  };

  std::string load_files() const;
  void check_name();
  static int on_verify(int is_good, X509_STORE_CTX* certificates);
  static void on_handshake(const SSL* session, int where, int result);
  static TlsClient& of(const SSL* session);

  const BrokerSettings broker_;
  const std::unique_ptr<SSL_CTX, Free> context_;
  bool is_address_ = false;  ///< the host is one: no name for the ClientHello
  int certificate_error_ = 0;
  bool has_shaken_hands_ = false;
  std::string problem_;
};

/// Takes the newest error of OpenSSL on this thread off its queue and puts it into words.
std::string last_tls_error();
/// What to do about a TLS failure that is none of the certificate's; `reason` in OpenSSL's words.
std::string explain_handshake_failure(const std::string& reason);
/// The same, of a broker that ends TLS after the handshake.
std::string explain_tls_end(const std::string& reason);

}  // namespace slamgw
