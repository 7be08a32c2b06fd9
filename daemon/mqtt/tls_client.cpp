// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/tls_client.hpp"

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/x509_vfy.h>

namespace slamgw {
namespace {

constexpr int owner_slot = 0;  // OpenSSL's slot for an application's own pointer

std::string explain_certificate(int error, const BrokerSettings& broker) {
  const std::string what = X509_verify_cert_error_string(error);
  switch (error) {
    case X509_V_ERR_HOSTNAME_MISMATCH:
    case X509_V_ERR_IP_ADDRESS_MISMATCH:
      return fmt::format(
          "the broker's certificate is not for '{}' ({}): broker.uri must use a name "
          "that is in the certificate",
          broker.host, what);
    case X509_V_ERR_CERT_HAS_EXPIRED:
    case X509_V_ERR_CERT_NOT_YET_VALID:
      return fmt::format(
          "the broker's certificate is not valid now ({}): renew it, or set this "
          "host's clock",
          what);
    default:
      return fmt::format(
          "the broker's certificate is not trusted ({}): broker.tls.ca_file must name "
          "the CA that signed it",
          what);
  }
}

}  // namespace

TlsClient::TlsClient(const BrokerSettings& broker)
    : broker_(broker), context_(SSL_CTX_new(TLS_client_method())) {
  SSL_CTX_set_ex_data(context(), owner_slot, this);
  SSL_CTX_set_verify(context(), SSL_VERIFY_PEER, &TlsClient::on_verify);
  SSL_CTX_set_info_callback(context(), &TlsClient::on_handshake);
  SSL_CTX_set_min_proto_version(context(), TLS1_2_VERSION);
  problem_ = load_files();
  check_name();
}

std::string TlsClient::load_files() const {
  const auto fails = [](const char* key, const std::string& file) {
    return fmt::format("{}: {} can't be used: {}", key, file, last_tls_error());
  };
  if (!broker_.ca_file) {
    SSL_CTX_set_default_verify_paths(context());
  } else if (SSL_CTX_load_verify_locations(context(), broker_.ca_file->c_str(), nullptr) != 1) {
    return fails("broker.tls.ca_file", *broker_.ca_file);
  }
  if (broker_.certificate_file &&
      SSL_CTX_use_certificate_chain_file(context(), broker_.certificate_file->c_str()) != 1)
    return fails("broker.tls.certificate_file", *broker_.certificate_file);
  if (broker_.key_file &&
      SSL_CTX_use_PrivateKey_file(context(), broker_.key_file->c_str(), SSL_FILETYPE_PEM) != 1)
    return fails("broker.tls.key_file", *broker_.key_file);
  return {};
}

void TlsClient::check_name() {
  X509_VERIFY_PARAM* check = SSL_CTX_get0_param(context());
  is_address_ = X509_VERIFY_PARAM_set1_ip_asc(check, broker_.host.c_str()) == 1;
  if (!is_address_) X509_VERIFY_PARAM_set1_host(check, broker_.host.c_str(), 0);
  ERR_clear_error();
}

TlsClient& TlsClient::of(const SSL* session) {
  return *static_cast<TlsClient*>(SSL_CTX_get_ex_data(SSL_get_SSL_CTX(session), owner_slot));
}

int TlsClient::on_verify(int is_good, X509_STORE_CTX* certificates) {
  if (is_good != 1) {
    const void* session =
        X509_STORE_CTX_get_ex_data(certificates, SSL_get_ex_data_X509_STORE_CTX_idx());
    of(static_cast<const SSL*>(session)).certificate_error_ =
        X509_STORE_CTX_get_error(certificates);
  }
  return is_good;
}

/// Names the broker in the ClientHello (RFC 6066 section 3): a client library that was given an
/// address has put the address there.
void TlsClient::on_handshake(const SSL* session, int where, int) {
  TlsClient& tls = of(session);
  if ((where & SSL_CB_HANDSHAKE_DONE) != 0) tls.has_shaken_hands_ = true;
  if ((where & SSL_CB_HANDSHAKE_START) == 0 || tls.has_shaken_hands_) return;
  char* name = tls.is_address_ ? nullptr : const_cast<char*>(tls.broker_.host.c_str());
  // OpenSSL's macro for this call has an old-style cast. OpenSSL copies the name. It passes the
  // session to this callback as const, but allows the callback to change it.
  SSL_ctrl(const_cast<SSL*>(session), SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name,
           name);
}

std::string TlsClient::certificate_problem() const {
  return certificate_error_ == X509_V_OK ? "" : explain_certificate(certificate_error_, broker_);
}

std::string last_tls_error() {
  const char* reason = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  return reason ? reason : "the broker closed the connection";
}

std::string explain_handshake_failure(const std::string& reason) {
  return fmt::format("TLS fails: {}; is this the broker's TLS port?", reason);
}

std::string explain_tls_end(const std::string& reason) {
  return fmt::format(
      "the broker ends TLS: {}; does it want a client certificate "
      "(broker.tls.certificate_file, broker.tls.key_file)?",
      reason);
}

}  // namespace slamgw
