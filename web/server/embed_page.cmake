# SPDX-License-Identifier: Apache-2.0
# cmake -DPAGE=dir -DOUT=file.cpp -DGZIP=gzip -P embed_page.cmake: the page's files, plain and compressed, as C++.
file(GLOB files "${PAGE}/*")
list(SORT files)
set(arrays "")
set(rows "")
set(number 0)
function(octets name hex)
  string(REGEX REPLACE "(..)" "0x\\1," list "${hex}")
  string(LENGTH "${hex}" digits)
  math(EXPR count "${digits} / 2")
  set(arrays "${arrays}constexpr unsigned char ${name}[] = {${list}};\nconstexpr std::size_t ${name}_size = ${count};\n" PARENT_SCOPE)
endfunction()
set(type_html "text/html; charset=utf-8")
set(type_css "text/css; charset=utf-8")
set(type_js "text/javascript; charset=utf-8")
set(type_svg "image/svg+xml")
foreach(file ${files})
  get_filename_component(name "${file}" NAME)
  string(REGEX REPLACE ".*\\." "" ending "${name}")
  if(NOT DEFINED type_${ending})
    message(FATAL_ERROR "web/page/${name}: no content type for .${ending}")
  endif()
  file(READ "${file}" text HEX)
  execute_process(COMMAND "${GZIP}" -9nc "${file}" OUTPUT_FILE "${OUT}.gz" COMMAND_ERROR_IS_FATAL ANY)
  file(READ "${OUT}.gz" gzip HEX)
  file(REMOVE "${OUT}.gz")
  file(SHA256 "${file}" hash)
  string(SUBSTRING "${hash}" 0 16 hash)
  octets(text_${number} "${text}")
  octets(gzip_${number} "${gzip}")
  if(name STREQUAL "index.html")
    set(name "")
  endif()
  string(APPEND rows "    {\"/${name}\", \"${type_${ending}}\", view(text_${number}, text_${number}_size),\n     view(gzip_${number}, gzip_${number}_size), \"\\\"${hash}\\\"\"},\n")
  math(EXPR number "${number} + 1")
endforeach()
file(WRITE "${OUT}" "// Made by embed_page.cmake.
#include \"web/server/page_files.hpp\"

#include <array>
#include <cstddef>

namespace slamgw::web {
namespace {
${arrays}
std::string_view view(const unsigned char* octets, std::size_t size) {
  return {reinterpret_cast<const char*>(octets), size};
}
}  // namespace

std::span<const PageFile> page_files() {
  static const std::array<PageFile, ${number}> files{{
${rows}  }};
  return files;
}

}  // namespace slamgw::web
")
