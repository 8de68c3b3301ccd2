// Brings the jobs of an earlier run back from the data folder.
#pragma once

#include "absl/status/status.h"
#include "server/coordinator_host.h"
#include "server/store/asset_store.h"
#include "server/store/job_storage.h"

namespace tessera {

// Hands every job of the catalogue to the coordinator, with its film if it has not ended. What is
// damaged or missing costs its own job only, and the log says what is lost and what happens: a job
// whose record is damaged is left out (its row and its film stay), one without its film renders its
// samples again, one without its assets fails. Removes films that belong to no row.
// Errors: the catalogue's.
absl::Status RestoreJobs(RowStorage& catalogue, const FilmStorage& films, AssetStore& assets,
                         const SettingsDefaults& defaults, CoordinatorHost& host);

}  // namespace tessera
