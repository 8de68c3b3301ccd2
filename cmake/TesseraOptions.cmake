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
