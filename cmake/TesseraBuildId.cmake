# Writes core/base/build_id.h: the release, and a digest of the sources and the compiler that decide
# the bits of a picture. Included by core/CMakeLists.txt, and run as a script when a source changes.
if(CMAKE_SCRIPT_MODE_FILE)
  file(GLOB_RECURSE sources RELATIVE ${SOURCE_DIR}
    ${SOURCE_DIR}/core/*.h ${SOURCE_DIR}/core/*.cpp
    ${SOURCE_DIR}/worker/*.h ${SOURCE_DIR}/worker/*.cpp
    ${SOURCE_DIR}/proto/*.proto ${SOURCE_DIR}/cmake/TesseraOptions.cmake)
  list(SORT sources)
  set(digests "${COMPILER}\n")
  foreach(source IN LISTS sources)
    file(SHA256 ${SOURCE_DIR}/${source} digest)
    string(APPEND digests "${digest} ${source}\n")
  endforeach()
  string(SHA256 build_id "${digests}")
  string(SUBSTRING ${build_id} 0 8 build_id)
  file(WRITE ${OUTPUT}.new
    "#define TESSERA_RELEASE \"${RELEASE}\"\n#define TESSERA_BUILD_ID \"${build_id}\"\n")
  file(COPY_FILE ${OUTPUT}.new ${OUTPUT} ONLY_IF_DIFFERENT)
  file(REMOVE ${OUTPUT}.new)
  return()
endif()

set(build_id_header ${PROJECT_BINARY_DIR}/generated/core/base/build_id.h)
file(GLOB_RECURSE build_id_sources CONFIGURE_DEPENDS
  ${PROJECT_SOURCE_DIR}/core/*.h ${PROJECT_SOURCE_DIR}/core/*.cpp
  ${PROJECT_SOURCE_DIR}/worker/*.h ${PROJECT_SOURCE_DIR}/worker/*.cpp
  ${PROJECT_SOURCE_DIR}/proto/*.proto)
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/generated/core/base)
add_custom_command(
  OUTPUT ${build_id_header}
  COMMAND ${CMAKE_COMMAND} -D SOURCE_DIR=${PROJECT_SOURCE_DIR} -D OUTPUT=${build_id_header}
    -D RELEASE=${PROJECT_VERSION} -D COMPILER=${CMAKE_CXX_COMPILER_ID}-${CMAKE_CXX_COMPILER_VERSION}
    -P ${PROJECT_SOURCE_DIR}/cmake/TesseraBuildId.cmake
  DEPENDS ${build_id_sources} ${PROJECT_SOURCE_DIR}/cmake/TesseraBuildId.cmake
    ${PROJECT_SOURCE_DIR}/cmake/TesseraOptions.cmake
  COMMENT "Build id of the sources"
  VERBATIM)
