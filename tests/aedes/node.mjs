// A node of a cluster of aedes, which keeps and hands on everything over Redis: node.mjs PORT REDIS_PORT NAME
import { createServer } from 'node:net'
import { Aedes } from 'aedes'
import redisPersistence from 'aedes-persistence-redis'
import redisEmitter from 'mqemitter-redis'

const [port, redis, name] = process.argv.slice(2)
// without a limit of attempts: a node that does not reach Redis waits for it, and does not end
const connection = { host: '127.0.0.1', port: Number(redis), enableReadyCheck: false, maxRetriesPerRequest: null }

/** Time after which a message of a disconnected client no longer delays others, ms. */
const TURN_MAX = 1000

// aedes numbers messages when they come, and drops one with a lower number than the last as a repetition. A retained message is
// stored before it is handed on, so that one which is not retained would overtake it: they are handed on one at a time.
let last = Promise.resolve()
let end = () => {}
const inTurn = (client, packet, done) => {
  const before = last
  last = before.then(() => new Promise((resolve) => {
    end = resolve
    setTimeout(resolve, TURN_MAX)
    done(null)
  }))
}

const emitter = redisEmitter(connection)
emitter.state.on('error', (error) => console.error(`Redis: ${error.message}`))

const broker = await Aedes.createBroker({
  // a new id at each start: a node that restarts its counter under its old name is mistaken for one that repeats
  // messages
  id: `${name}-${Date.now()}`,
  persistence: redisPersistence(connection),
  mq: emitter,
  authorizePublish: inTurn,
  published: (packet, client, done) => {
    if (client) end()
    done()
  },
})
createServer((socket) => {
  socket.setNoDelay(true)
  broker.handle(socket)
}).listen(Number(port), '127.0.0.1', () => console.log('listens'))
