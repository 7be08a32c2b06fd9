# SPDX-License-Identifier: Apache-2.0
# One call for each kind of target, so that all share the same flags.

add_library(slamgw_flags INTERFACE)
target_compile_features(slamgw_flags INTERFACE cxx_std_20)
target_compile_options(slamgw_flags INTERFACE -Wall -Wextra -Wconversion -Wnon-virtual-dtor -Wold-style-cast
                                              -Woverloaded-virtual)
if(NOT SLAMGW_UNITY)
  target_compile_options(slamgw_flags INTERFACE -Wshadow)
elseif(CMAKE_CXX_COMPILER_ID STREQUAL "GNU") # -Wshadow would also warn of names in other files' anonymous namespaces
  target_compile_options(slamgw_flags INTERFACE -Wshadow=local)
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  # With -O2, g++ 12 takes members of a moved std::variant for uninitialized, in libstdc++'s own code.
  target_compile_options(slamgw_flags INTERFACE $<$<NOT:$<CONFIG:Debug>>:-Wno-maybe-uninitialized>)
endif()
if(CMAKE_SYSTEM_PROCESSOR MATCHES "^arm") # g++ tells there of each value that it passed in another way before GCC 7
  target_compile_options(slamgw_flags INTERFACE -Wno-psabi)
endif()
if(SLAMGW_WERROR)
  target_compile_options(slamgw_flags INTERFACE -Werror)
endif()
target_include_directories(slamgw_flags INTERFACE "${PROJECT_SOURCE_DIR}")

# slamgw_library(name SOURCES a.cpp ... DEPENDS target ...)
function(slamgw_library name)
  cmake_parse_arguments(arg "" "" "SOURCES;DEPENDS" ${ARGN})
  add_library(${name} STATIC ${arg_SOURCES})
  target_link_libraries(${name} PUBLIC slamgw_flags ${arg_DEPENDS})
endfunction()

# slamgw_program(name SOURCES a.cpp ... DEPENDS target ... [DESTINATION dir]): ends in <build>/bin, installed in bin or dir
function(slamgw_program name)
  cmake_parse_arguments(arg "" "DESTINATION" "SOURCES;DEPENDS" ${ARGN})
  if(NOT arg_DESTINATION)
    set(arg_DESTINATION "${CMAKE_INSTALL_BINDIR}")
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE slamgw_flags ${arg_DEPENDS})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
  install(TARGETS ${name} DESTINATION "${arg_DESTINATION}")
endfunction()

add_custom_target(pure_tests) # builds the tests with the label "pure"

# slamgw_test(name SOURCES a.cpp ... DEPENDS target ... [LABEL pure|io|e2e] [TIMEOUT s]): each TEST becomes a ctest.
# Its timeout is for a test that hangs: long enough for a sanitizer on a machine that does other things as well. What waits for
# processes and sockets begins first (COST), while there are short tests to fill the pauses.
function(slamgw_test name)
  cmake_parse_arguments(arg "" "LABEL;TIMEOUT" "SOURCES;DEPENDS" ${ARGN})
  if(NOT BUILD_TESTING)
    return()
  endif()
  if(NOT arg_LABEL)
    set(arg_LABEL pure)
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  set(cost_pure 0)
  set(cost_io 50)
  set(cost_e2e 100)
  if(CMAKE_CROSSCOMPILING) # an emulator runs them
    math(EXPR arg_TIMEOUT "${arg_TIMEOUT} * 10")
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE slamgw_flags ${arg_DEPENDS} GTest::gtest GTest::gtest_main)
  if(arg_LABEL STREQUAL "pure")
    add_dependencies(pure_tests ${name})
  endif()
  if(SLAMGW_WHOLE_PROGRAMS AND arg_LABEL STREQUAL "pure")
    foreach(shard 0 1)
      add_test(NAME ${name}.${shard} COMMAND ${name} --gtest_brief=1)
      set_tests_properties(${name}.${shard} PROPERTIES LABELS pure TIMEOUT 1200
                           ENVIRONMENT "GTEST_TOTAL_SHARDS=2;GTEST_SHARD_INDEX=${shard}")
    endforeach()
  else()
    gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 300
                         PROPERTIES LABELS "${arg_LABEL}" TIMEOUT ${arg_TIMEOUT} COST ${cost_${arg_LABEL}})
  endif()
endfunction()

# slamgw_fuzz(name SOURCES a.cpp DEPENDS target ...): a libFuzzer program, in the fuzz preset only
function(slamgw_fuzz name)
  cmake_parse_arguments(arg "" "" "SOURCES;DEPENDS" ${ARGN})
  if(SLAMGW_FUZZ)
    add_executable(${name} ${arg_SOURCES})
    target_link_libraries(${name} PRIVATE slamgw_flags ${arg_DEPENDS})
    target_link_options(${name} PRIVATE -fsanitize=fuzzer)
    set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
  endif()
endfunction()
