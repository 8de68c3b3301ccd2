// Asks a server that does not exist for its jobs; done if the library says so as promised.
#include <cstdio>

#include <grpcpp/create_channel.h>

#include "client/farm_client.h"
#include "core/base/version.h"

int main() {
  tessera::FarmClientOptions options;
  options.address = "127.0.0.1:1";
  options.retry.first_contact_attempts = 1;
  tessera::FarmClient client(
      grpc::CreateChannel(options.address, grpc::InsecureChannelCredentials()), options);
  const auto jobs = client.ListJobs();
  std::printf("tessera %s: %s\n", tessera::kVersion, jobs.status().ToString().c_str());
  return absl::IsUnavailable(jobs.status()) ? 0 : 1;
}
