# Options, the language standard, and the flags that every target of the project shares.
option(TESSERA_TESTS "Build the tests" ON)
option(TESSERA_BENCH "Build the benchmarks" ON)
option(TESSERA_WERROR "Treat warnings as errors" OFF)
set(TESSERA_SANITIZE "" CACHE STRING "Sanitizers, comma-separated: address,undefined or thread")

set(TESSERA_ISA_LEVEL x86-64-v3 CACHE STRING
  "Oldest processors that the programs run on: x86-64-v2 (2009) or x86-64-v3 (2013)")
set_property(CACHE TESSERA_ISA_LEVEL PROPERTY STRINGS x86-64-v2 x86-64-v3)
if(NOT TESSERA_ISA_LEVEL MATCHES "^x86-64-v[23]$")
  message(FATAL_ERROR "TESSERA_ISA_LEVEL is '${TESSERA_ISA_LEVEL}': give x86-64-v2 or x86-64-v3")
endif()

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)

find_program(TESSERA_CCACHE ccache)
if(TESSERA_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${TESSERA_CCACHE})
endif()

# Linked PRIVATE by every target: warnings, and the arithmetic that C2 (same bits) rests on.
add_library(tessera_flags INTERFACE)
add_library(tessera::flags ALIAS tessera_flags)
target_compile_options(tessera_flags INTERFACE
  -march=${TESSERA_ISA_LEVEL} -ffp-contract=off -fno-math-errno
  -Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Woverloaded-virtual -Wimplicit-fallthrough
  $<$<BOOL:${TESSERA_WERROR}>:-Werror>
  $<$<CXX_COMPILER_ID:Clang>:-Wthread-safety>)
if(TESSERA_SANITIZE)
  target_compile_options(tessera_flags INTERFACE -fsanitize=${TESSERA_SANITIZE} -fno-omit-frame-pointer -g)
  target_link_options(tessera_flags INTERFACE -fsanitize=${TESSERA_SANITIZE})
endif()

# A program that links tessera::program_flags is optimised across the sources of the libraries that
# link tessera::hot_flags: 1 to 4 % of a sample's time (docs/path-tracer.md). Their objects hold
# ordinary code as well, for all else, which links in a fraction of the time.
add_library(tessera_hot_flags INTERFACE)
add_library(tessera::hot_flags ALIAS tessera_hot_flags)
add_library(tessera_program_flags INTERFACE)
add_library(tessera::program_flags ALIAS tessera_program_flags)
if(CMAKE_CXX_COMPILER_ID STREQUAL GNU AND CMAKE_BUILD_TYPE STREQUAL Release AND NOT TESSERA_SANITIZE)
  target_compile_options(tessera_hot_flags INTERFACE -flto -ffat-lto-objects)
  target_link_options(tessera_program_flags INTERFACE -flto=auto)
  target_link_options(tessera_flags INTERFACE
    $<$<NOT:$<IN_LIST:tessera::program_flags,$<TARGET_PROPERTY:LINK_LIBRARIES>>>:-fno-lto>)
endif()
