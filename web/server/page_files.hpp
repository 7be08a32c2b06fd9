// SPDX-License-Identifier: Apache-2.0
// The files of web/page, embedded when the program is built (embed_page.cmake).
#pragma once

#include <span>
#include <string_view>

namespace slamgw::web {

struct PageFile {
  std::string_view path;  ///< as browsers request it: `/`, `/map.js`
  std::string_view content_type;
  std::string_view text;
  std::string_view gzip;  ///< the text, compressed
  std::string_view etag;  ///< with its quotation marks
};

std::span<const PageFile> page_files();

}  // namespace slamgw::web
