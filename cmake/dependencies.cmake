# SPDX-License-Identifier: Apache-2.0
# Finds everything that Debian provides; each failure names the package to install.

function(slamgw_need_header variable header package)
  find_path(${variable} ${header})
  if(NOT ${variable})
    message(FATAL_ERROR "slam-gateway needs ${header}: install the Debian package ${package} (apt-get install ${package}).")
  endif()
endfunction()

macro(slamgw_need_package name package) # a macro: what a package sets must reach the caller
  find_package(${name} QUIET)
  if(NOT ${name}_FOUND)
    message(FATAL_ERROR "slam-gateway needs ${name}: install the Debian package ${package} (apt-get install ${package}).")
  endif()
endmacro()

slamgw_need_header(SLAMGW_BOOST_INCLUDE boost/version.hpp "libboost1.81-dev (Debian 12) or libboost-dev (Debian 13)")
file(STRINGS "${SLAMGW_BOOST_INCLUDE}/boost/version.hpp" boost_version_line REGEX "#define BOOST_VERSION ")
string(REGEX REPLACE "[^0-9]" "" boost_version "${boost_version_line}")
if(boost_version LESS 108100)
  message(FATAL_ERROR
    "slam-gateway needs Boost 1.81 or newer, found ${boost_version}: Debian 12's libboost-dev is 1.74, whose Asio does not "
    "compile as C++20; install libboost1.81-dev instead (apt-get install libboost1.81-dev).")
endif()
add_library(slamgw_boost INTERFACE)
target_include_directories(slamgw_boost SYSTEM INTERFACE "${SLAMGW_BOOST_INCLUDE}")

slamgw_need_package(fmt libfmt-dev)
slamgw_need_package(nlohmann_json nlohmann-json3-dev)
slamgw_need_package(OpenSSL libssl-dev)

if(SLAMGW_FUZZ)
  return() # the pure libraries need nothing else
endif()

slamgw_need_package(Threads libc6-dev)
slamgw_need_package(spdlog libspdlog-dev)
slamgw_need_package(CLI11 libcli11-dev)
slamgw_need_header(SLAMGW_PAHO_C_INCLUDE MQTTAsync.h libpaho-mqtt-dev)
slamgw_need_package(PahoMqttCpp libpaho-mqttpp-dev)
slamgw_need_package(PkgConfig pkg-config)

macro(slamgw_need_module target module package)
  pkg_check_modules(${target} QUIET IMPORTED_TARGET ${module})
  if(NOT ${target}_FOUND)
    message(FATAL_ERROR "slam-gateway needs ${module}: install the Debian package ${package} (apt-get install ${package}).")
  endif()
endmacro()

slamgw_need_module(MOSQUITTO libmosquitto libmosquitto-dev)
slamgw_need_module(QRENCODE libqrencode libqrencode-dev)
slamgw_need_module(SERIALPORT libserialport libserialport-dev)
slamgw_need_module(SYSTEMD libsystemd libsystemd-dev)
if(BUILD_TESTING)
  slamgw_need_package(GTest libgtest-dev)
endif()
