# `cmake --install`: the three programs, and the client library for find_package(tessera).
# Components: runtime (programs, bash completion) and development (library, headers).
include(CMakePackageConfigHelpers)

install(TARGETS tessera tessera-server tessera-worker
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT runtime)
install(FILES ${PROJECT_SOURCE_DIR}/deploy/completion/tessera
  DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT runtime)

# What tessera::client consists of. Include paths are those of the repository.
set(tessera_headers ${CMAKE_INSTALL_INCLUDEDIR}/tessera)
foreach(part client core)
  target_include_directories(tessera_${part} PUBLIC $<INSTALL_INTERFACE:${tessera_headers}>)
  target_compile_features(tessera_${part} PUBLIC cxx_std_20)
endforeach()
foreach(part client core proto flags)
  set_target_properties(tessera_${part} PROPERTIES EXPORT_NAME ${part})
endforeach()
install(TARGETS tessera_client tessera_core tessera_proto tessera_flags EXPORT tesseraTargets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT development)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/client ${PROJECT_SOURCE_DIR}/core
  DESTINATION ${tessera_headers} COMPONENT development
  FILES_MATCHING PATTERN "*.h"
  PATTERN "cli" EXCLUDE
  PATTERN "image_input.h" EXCLUDE)
install(DIRECTORY ${PROJECT_BINARY_DIR}/proto/tessera
  DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development
  FILES_MATCHING PATTERN "*.pb.h")

set(tessera_package ${CMAKE_INSTALL_LIBDIR}/cmake/tessera)
install(EXPORT tesseraTargets NAMESPACE tessera:: DESTINATION ${tessera_package}
  COMPONENT development)
configure_package_config_file(
  ${PROJECT_SOURCE_DIR}/cmake/tesseraConfig.cmake.in ${PROJECT_BINARY_DIR}/tesseraConfig.cmake
  INSTALL_DESTINATION ${tessera_package})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/tesseraConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/tesseraConfig.cmake
  ${PROJECT_BINARY_DIR}/tesseraConfigVersion.cmake
  DESTINATION ${tessera_package} COMPONENT development)
