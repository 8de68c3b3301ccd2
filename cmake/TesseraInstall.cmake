# `cmake --install`: the three programs, and the client library for find_package(tessera).
# Components: runtime (programs, bash completion) and development (library, headers). Programs go
# to libexec, by the x86-64 level they are compiled for, launchers to bin: builds for several levels
# are installed into one prefix, and each processor gets the fastest that it runs.
include(CMakePackageConfigHelpers)

set(tessera_copy ${CMAKE_INSTALL_LIBEXECDIR}/tessera/${TESSERA_ISA_LEVEL})
install(TARGETS tessera tessera-server tessera-worker
  RUNTIME DESTINATION ${tessera_copy} COMPONENT runtime)
# `tessera chart` looks beside the program that runs.
file(RELATIVE_PATH chart_from_copy
  /prefix/${tessera_copy} /prefix/${CMAKE_INSTALL_BINDIR}/tessera-chart)
install(CODE "file(CREATE_LINK ${chart_from_copy}
  \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${tessera_copy}/tessera-chart\" SYMBOLIC)"
  COMPONENT runtime)
foreach(program tessera tessera-server tessera-worker)
  install(PROGRAMS $<TARGET_FILE:${program}-launcher> RENAME ${program}
    DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT runtime)
endforeach()
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
