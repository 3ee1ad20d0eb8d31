/** The module of a worker that has a client: `WorkerClient` starts it. */

import { serve, type Port } from "./remote.js";

serve(globalThis as unknown as Port);
