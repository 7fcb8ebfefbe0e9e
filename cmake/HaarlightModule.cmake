# SPDX-License-Identifier: Apache-2.0
# haarlight_add_module(NAME SOURCES a.cpp ... [HEADERS a.h ...] [PUBLIC_DEPS ...] [PRIVATE_DEPS ...]
#                      [CONTROL [LOOPS a.cpp ...] | CONTROL_SOURCES a.cpp ...]
#                      [OWN_FLAGS] [INTERNAL])
#   A library haarlight_NAME with alias haarlight::NAME. Sources are relative to the calling
#   folder. HEADERS: those without a source of their name, which the target
#   all_verify_interface_header_sets compiles alone; the others stand first in their source.
#   CONTROL: decides and talks, but for LOOPS, its sources that go over pixels: -O1 does for it,
#   and compiles in two thirds of -O3's time. CONTROL_SOURCES: where only these are so.
#   OWN_FLAGS: its flags are not those of the precompiled headers. INTERNAL: for our programs or
#   tests alone, not installed.
#   Public headers are below include/haarlight, by the folders of their sources, and installed;
#   the others stand beside their sources, and only haarlight's own targets find them.
#
# haarlight_add_methods(NAME SOURCES a_methods.cpp [HEADERS a.h ...] DEPS haarlight::x ...)
#   A module's table of methods (core/method.h) as haarlight::NAME, where tests or benchmarks are
#   built; bench/methods links all of them.
#
# haarlight_add_test(NAME SOURCES a_test.cpp ... DEPS haarlight::x ... [LABELS unit ...]
#                    [SLOW Suite.Test ... [SLOW_SOURCES a_test.cpp ...]] [COST seconds]
#                    [PREFIX text] [NO_TSAN] [TOGETHER])
#   A GoogleTest program NAME whose tests ctest finds. Labels: unit (default), golden, property,
#   slow (release build only), soak (./check --full only). SLOW: those of a unit program's tests
#   that count as slow all the same (GoogleTest patterns). SLOW_SOURCES: those of SOURCES that
#   hold them; they make a program NAME_slow, so that slow_tests does not compile the others.
#   COST: start early, as a test of so many seconds; ctest knows that only from its second run
#   on. PREFIX: before the tests' names, where another program has tests of the same names.
#   NO_TSAN: no thread of its own beyond core/parallel.h's loops; left out of the tsan build.
#   TOGETHER: one test for ctest, where the program's tests share what is dear to make, or are many
#   short ones.
#
# haarlight_test_program(NAME SOURCES a_test.cpp ... DEPS haarlight::x ...)
#   A GoogleTest program of which ctest knows nothing yet.
#
# haarlight_add_fuzzer(NAME SOURCES a_fuzz.cpp DEPS haarlight::x ... CORPUS folder)
#   With HAARLIGHT_FUZZ a libFuzzer program, and a test that runs it over the corpus once, with the
#   limits of scripts/run_fuzzers: 256 KiB of input, 2 GiB of memory, 10 s; in other builds nothing.
#
# The targets unit_tests and slow_tests build what the labels ask for.

include(GoogleTest)
add_custom_target(unit_tests)
add_custom_target(slow_tests)

function(haarlight_add_module)
  cmake_parse_arguments(ARG "CONTROL;OWN_FLAGS;INTERNAL" "NAME"
                        "SOURCES;HEADERS;PUBLIC_DEPS;PRIVATE_DEPS;LOOPS;CONTROL_SOURCES" ${ARGN})
  set(target haarlight_${ARG_NAME})
  if(ARG_LOOPS AND NOT ARG_CONTROL)
    message(FATAL_ERROR "${ARG_NAME}: LOOPS are those of a CONTROL module")
  endif()
  set(others ${ARG_LOOPS} ${ARG_CONTROL_SOURCES})  # than the module's level of optimisation
  add_library(${target} STATIC ${ARG_SOURCES})
  add_library(haarlight::${ARG_NAME} ALIAS ${target})
  file(RELATIVE_PATH room ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  set(public ${PROJECT_SOURCE_DIR}/include)
  set(of_sources)
  set(alone)
  set(alone_private)
  foreach(source ${ARG_SOURCES})
    cmake_path(REPLACE_EXTENSION source LAST_ONLY .h OUTPUT_VARIABLE header)
    if(EXISTS ${public}/haarlight/${room}/${header})
      list(APPEND of_sources ${public}/haarlight/${room}/${header})
    endif()
  endforeach()
  foreach(header ${ARG_HEADERS})
    if(EXISTS ${public}/haarlight/${room}/${header})
      list(APPEND alone ${public}/haarlight/${room}/${header})
    else()
      list(APPEND alone_private ${CMAKE_CURRENT_SOURCE_DIR}/${header})
    endif()
  endforeach()
  target_sources(${target} PUBLIC FILE_SET HEADERS BASE_DIRS ${public} FILES ${alone}
                                  FILE_SET of_sources TYPE HEADERS BASE_DIRS ${public} FILES ${of_sources})
  set_target_properties(${target} PROPERTIES INTERFACE_HEADER_SETS_TO_VERIFY HEADERS
                                             EXPORT_NAME ${ARG_NAME})
  if(alone_private)
    # A target of their own: what an installed target has must be installed.
    add_library(${target}_private INTERFACE)
    target_sources(${target}_private INTERFACE FILE_SET HEADERS BASE_DIRS ${PROJECT_SOURCE_DIR}
                                               FILES ${alone_private})
    target_link_libraries(${target}_private INTERFACE ${target} haarlight::warnings)
  endif()
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_link_libraries(${target} PUBLIC ${ARG_PUBLIC_DEPS}
                        PRIVATE $<BUILD_INTERFACE:haarlight::warnings> ${ARG_PRIVATE_DEPS})
  if(NOT ARG_INTERNAL)
    haarlight_install_module(${target})
  endif()
  if(NOT ARG_OWN_FLAGS)
    haarlight_use_headers(${target} source)
  endif()
  if(ARG_CONTROL)
    haarlight_control(${target})
    set(level -O3)
  else()
    set(level -O1)
  endif()
  set_property(SOURCE ${others} APPEND PROPERTY COMPILE_OPTIONS $<$<CONFIG:Release>:${level}>)
endfunction()

function(haarlight_add_methods)
  if(NOT HAARLIGHT_TESTS AND NOT HAARLIGHT_BUILD_BENCH)
    return()
  endif()
  cmake_parse_arguments(ARG "" "NAME" "SOURCES;HEADERS;DEPS" ${ARGN})
  haarlight_add_module(NAME ${ARG_NAME} SOURCES ${ARG_SOURCES} HEADERS ${ARG_HEADERS} PUBLIC_DEPS haarlight::core
                       PRIVATE_DEPS ${ARG_DEPS} INTERNAL)
  set_property(GLOBAL APPEND PROPERTY HAARLIGHT_METHODS haarlight::${ARG_NAME})
endfunction()

function(haarlight_control TARGET)
  target_compile_options(${TARGET} PRIVATE $<$<CONFIG:Release>:-O1>)
endfunction()

function(haarlight_test_program)
  cmake_parse_arguments(ARG "" "NAME" "SOURCES;DEPS" ${ARGN})
  add_executable(${ARG_NAME} ${ARG_SOURCES})
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS} haarlight::warnings GTest::gmock
                                            GTest::gtest_main rapidcheck rapidcheck_gtest)
  target_compile_options(${ARG_NAME} PRIVATE ${HAARLIGHT_TEST_FLAGS})
  haarlight_use_headers(${ARG_NAME} test)
  # Tests run in the source folder: no path of a machine enters a compile command, so that the
  # compiler cache serves every clone.
  target_compile_definitions(${ARG_NAME} PRIVATE HAARLIGHT_SOURCE_DIR=".")
endfunction()

# Of haarlight_add_test's PROGRAM those tests that FILTER names, as NAME where it is TOGETHER.
macro(haarlight_register_tests PROGRAM NAME FILTER LABELS)
  set(properties TIMEOUT 600)
  if(ARG_COST)
    list(APPEND properties COST ${ARG_COST})
  endif()
  if(ARG_TOGETHER)
    add_test(NAME ${NAME} COMMAND ${PROGRAM} --gtest_filter=${FILTER}
             WORKING_DIRECTORY ${PROJECT_SOURCE_DIR})
    set_tests_properties(${NAME} PROPERTIES LABELS "${LABELS}" ${properties})
  else()
    gtest_discover_tests(${PROGRAM} WORKING_DIRECTORY ${PROJECT_SOURCE_DIR}
                         TEST_FILTER "${FILTER}" TEST_PREFIX "${ARG_PREFIX}" TEST_LIST ${NAME}
                         DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 60
                         PROPERTIES LABELS "${LABELS}" ${properties})
  endif()
endmacro()

function(haarlight_add_test)
  cmake_parse_arguments(ARG "NO_TSAN;TOGETHER" "NAME;COST;PREFIX"
                        "SOURCES;DEPS;LABELS;SLOW;SLOW_SOURCES" ${ARGN})
  if(HAARLIGHT_TSAN AND ARG_NO_TSAN)
    return()
  endif()
  haarlight_test_program(NAME ${ARG_NAME} SOURCES ${ARG_SOURCES} DEPS ${ARG_DEPS})
  if(NOT ARG_LABELS)
    set(ARG_LABELS unit)
  endif()
  string(JOIN ":" slow ${ARG_SLOW})
  haarlight_register_tests(${ARG_NAME} ${ARG_NAME} "-${slow}" "${ARG_LABELS}")
  if(ARG_SLOW)
    set(slow_program ${ARG_NAME})
    if(ARG_SLOW_SOURCES)
      set(slow_program ${ARG_NAME}_slow)
      haarlight_test_program(NAME ${slow_program} SOURCES ${ARG_SLOW_SOURCES} DEPS ${ARG_DEPS})
    endif()
    haarlight_register_tests(${slow_program} ${ARG_NAME}.slow "${slow}" slow)
    add_dependencies(slow_tests ${slow_program})
  endif()
  if("slow" IN_LIST ARG_LABELS OR "soak" IN_LIST ARG_LABELS)
    add_dependencies(slow_tests ${ARG_NAME})
  else()
    add_dependencies(unit_tests ${ARG_NAME})
  endif()
endfunction()

function(haarlight_add_fuzzer)
  cmake_parse_arguments(ARG "" "NAME;CORPUS" "SOURCES;DEPS" ${ARGN})
  if(NOT HAARLIGHT_FUZZ)
    return()
  endif()
  add_executable(${ARG_NAME} ${ARG_SOURCES})
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS} haarlight::warnings)
  target_link_options(${ARG_NAME} PRIVATE -fsanitize=fuzzer)
  add_test(NAME ${ARG_NAME}.corpus
           COMMAND ${ARG_NAME} -runs=0 -max_len=262144 -rss_limit_mb=2048 -timeout=10
                   ${CMAKE_CURRENT_SOURCE_DIR}/${ARG_CORPUS})
  set_tests_properties(${ARG_NAME}.corpus PROPERTIES LABELS unit)
  add_dependencies(unit_tests ${ARG_NAME})
endfunction()
