// SPDX-License-Identifier: Apache-2.0
// Feeds any text as configuration and as credentials: the parser reports problems and never
// crashes.
#include "daemon/config/parse.hpp"
#include "tests/config/fake_files.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(slamgw::as_text({data, size}));
  slamgw::test::FakeFiles files;
  files.files["/run/creds/broker"] = {text, 0600};
  const auto result =
      slamgw::parse_config({{"gateway.json", std::string(text)}}, {"host", "/run/creds"}, files);
  for (const slamgw::Problem& problem : result.problems)
    if (slamgw::to_string(problem).find('\n') != std::string::npos) __builtin_trap();
  return 0;
}
