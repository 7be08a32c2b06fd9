// SPDX-License-Identifier: Apache-2.0
#include "tests/support/certificates.hpp"

#include <stdexcept>
#include <vector>

#include "tests/support/child_process.hpp"

namespace slamgw::test {
namespace {

void openssl(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "openssl");
  ChildProcess process(arguments);
  if (process.wait() != 0) throw std::runtime_error("openssl " + arguments[1] + " failed");
}

}  // namespace

Certificates::Certificates(const std::string& host_name) {
  openssl({"req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
           "-days", "2", "-subj", "/CN=test authority", "-keyout", directory_ / "ca.key", "-out",
           ca()});
  openssl({"req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj",
           "/CN=" + host_name, "-keyout", key(), "-out", directory_ / "server.csr"});
  write_file(directory_ / "extensions", "subjectAltName=DNS:" + host_name + "\n");
  openssl({"x509", "-req", "-in", directory_ / "server.csr", "-CA", ca(), "-CAkey",
           directory_ / "ca.key", "-CAcreateserial", "-days", "2", "-extfile",
           directory_ / "extensions", "-out", certificate()});
}

}  // namespace slamgw::test
